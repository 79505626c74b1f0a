"""A camera that sees nothing for a while, is carried elsewhere, or is lost for long."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import Features, FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.inertial.imu import Imu, MeasuredRotation
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA, PERIOD_NS, World, position_errors_m, sway

POSES = sway(90)
LOST, TRACKING = SlamState.LOST, SlamState.TRACKING


def seen(world: World, n: int, pose: FloatArray, *, covered: bool = False) -> Features:
    features = world.features(n * PERIOD_NS, pose)
    return features.select(np.zeros(len(features), np.bool_)) if covered else features


def rmse_m(slam: RgbdSlam, poses: FloatArray) -> float:
    errors = position_errors_m(slam.trajectory.final(), poses)
    return float(np.sqrt((errors**2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('first', 'last'), [(30, 50), (40, 70)], ids=['covered lens', 'elsewhere afterwards']
)
def test_after_a_blackout_the_camera_is_found_at_once(first: int, last: int) -> None:
    world, slam = World(), RgbdSlam(CAMERA, SlamConfig())
    dark = range(first, last)
    results = [slam.process(seen(world, n, T, covered=n in dark)) for n, T in enumerate(POSES)]
    states = [r.state for r in results]
    assert states[first:last] == [LOST] * len(dark)
    assert states[:first] + states[last:] == [TRACKING] * (len(POSES) - len(dark))
    assert slam.stats.num_relocalizations == 1
    assert rmse_m(slam, POSES) < 0.015
    before, after = results[first - 1].T_odom_camera, results[last].T_odom_camera
    assert before is not None
    assert after is not None
    np.testing.assert_allclose(before, after, atol=1e-9)  # odometry never jumps


def test_a_jump_to_a_known_place() -> None:
    world, slam = World(), RgbdSlam(CAMERA, SlamConfig())
    order = [*range(60), *range(15, 30)]
    states = [slam.process(seen(world, n, POSES[at])).state for n, at in enumerate(order)]
    assert states == [TRACKING] * len(order)
    assert slam.stats.num_relocalizations == 1
    assert rmse_m(slam, POSES[order]) < 0.015


def test_what_is_mapped_where_nothing_is_known_stays_out_of_the_trajectory() -> None:
    """The camera is covered, carried into another room, and stays there."""
    config = SlamConfig().updated({'places.new_map_after_s': 0.2})
    here, there, slam = World(), World(seed=7), RgbdSlam(CAMERA, config)
    for n, pose in enumerate(POSES[:70]):
        world = here if n < 45 else there
        slam.process(seen(world, n, pose, covered=45 <= n < 50))
    stats, final = slam.stats, slam.trajectory.final()
    num_online = len(slam.trajectory.online())
    assert stats.num_maps == 2
    assert (stats.num_merges, stats.num_loops) == (0, 0)
    assert not slam.odometry.is_in_main_map
    assert final.stamps_ns.tolist() == [n * PERIOD_NS for n in range(45)]
    assert num_online > 55
    assert rmse_m(slam, POSES) < 0.015
    assert len(slam.trajectory.keyframes()) == stats.num_keyframes


def test_a_gap_in_the_stream_is_no_time_lost() -> None:
    """During a gap of ten seconds no image arrives; afterwards no new map is started at once."""
    here, there, slam = World(), World(seed=7), RgbdSlam(CAMERA, SlamConfig())
    for n, pose in enumerate(POSES[:20]):
        slam.process(seen(here, n, pose))
    gap = round(10e9 / PERIOD_NS)
    assert slam.process(seen(there, 20 + gap, POSES[0])).state is LOST
    assert slam.process(seen(here, 21 + gap, POSES[20])).state is TRACKING
    assert slam.stats.num_maps == 1


def covering(features: Features, depth_m: float, seed: int) -> Features:
    """Return features of an object that fills the view at one depth and resembles nothing."""
    rng = np.random.default_rng(seed)
    return replace(
        features,
        depth_m=np.full(len(features), depth_m, np.float32),
        descriptors=rng.integers(0, 256, features.descriptors.shape, dtype=np.uint8),
    )


@pytest.mark.parametrize(
    ('depth_m', 'starts'),
    [(0.5, []), (5.0, [12, 37, 86])],
    ids=['covered', 'new ground that cannot be tracked'],
)
def test_a_covered_view_waits_and_new_ground_starts_maps_ever_less_often(
    depth_m: float, starts: list[int]
) -> None:
    world, slam = World(), RgbdSlam(CAMERA, SlamConfig())
    for n in range(20):
        slam.process(seen(world, n, POSES[n]))
    lost = [covering(seen(world, n, POSES[20]), depth_m, seed=n) for n in range(20, 108)]
    states = [slam.process(features).state for features in lost]
    assert [n for n, state in enumerate(states) if state is TRACKING] == starts
    assert slam.process(seen(world, 108, POSES[20])).state is TRACKING
    assert slam.odometry.is_in_main_map


class StillGyro(Imu):
    """A calibrated gyro of a camera that does not turn."""

    def rotation(self, first_ns: int, second_ns: int) -> MeasuredRotation:  # noqa: ARG002
        """Return no rotation."""
        return MeasuredRotation(np.eye(3), 0.01)


@pytest.mark.parametrize(
    ('depth_m', 'starts'), [(0.5, []), (5.0, [12, 37, 68])], ids=['covered', 'new ground']
)
def test_new_ground_starts_a_map_before_a_gyro_stops_bridging(
    depth_m: float, starts: list[int]
) -> None:
    world, slam = World(), RgbdSlam(CAMERA, SlamConfig(), imu=StillGyro(ImuConfig()))
    for n in range(20):
        slam.process(seen(world, n, POSES[20]))
    lost = [covering(seen(world, n, POSES[20]), depth_m, seed=n) for n in range(20, 90)]
    states = [slam.process(features).state for features in lost]
    assert [n for n, state in enumerate(states) if state is TRACKING] == starts


def test_a_map_starts_in_the_first_sharp_image_and_in_a_poor_view_after_a_second() -> None:
    """Blurred images have few features, and after a second a view with few is taken as it is."""

    def starts(num_blurred: int) -> int:
        here, there, slam = World(), World(seed=7), RgbdSlam(CAMERA, SlamConfig())
        for n in range(20):
            slam.process(seen(here, n, POSES[n]))
        for n in range(60):
            features = seen(there, 20 + n, POSES[n])
            if n < num_blurred:
                features = features.select(np.arange(len(features)) % 2 == 0)
            if slam.process(features).state is TRACKING:
                return n
        raise AssertionError('no map was started')

    per_s = round(1e9 / PERIOD_NS)
    assert starts(20) == 20
    assert starts(60) in (per_s - 1, per_s)


LATER = 3000  # images, of a clock that is set back by 100 s then


@pytest.mark.slow
def test_after_stamps_that_go_back_another_scene_becomes_a_new_map() -> None:
    """A bag that is played again has such stamps: those of the map are in the future then."""
    here, there, slam = World(), World(seed=7), RgbdSlam(CAMERA, SlamConfig())
    for n, pose in enumerate(POSES[:30]):
        slam.process(seen(here, LATER + n, pose))
    states = [slam.process(seen(there, n, T)).state for n, T in enumerate(POSES[:60])]
    assert states[:12] == [LOST] * 12
    assert states[14:] == [TRACKING] * 46
    assert slam.stats.num_maps == 2


@pytest.mark.slow
def test_after_stamps_that_go_back_the_map_goes_on_growing() -> None:
    config = SlamConfig().updated({'keyframes.fallen_share': 0.0})  # which waits for no time
    world, slam = World(), RgbdSlam(CAMERA, config)
    for n, pose in enumerate(POSES[:10]):
        slam.process(seen(world, LATER + n, pose))
    results = [slam.process(seen(world, n, T)) for n, T in enumerate(POSES)]
    assert [r.state for r in results] == [TRACKING] * len(POSES)
    assert sum(r.is_keyframe for r in results) >= 3
    assert slam.stats.num_maps == 1


@pytest.mark.slow
def test_a_strange_place_becomes_a_map_of_its_own_that_is_merged_later() -> None:
    """The camera turns around while covered, maps the new view, and turns back uncovered."""
    config = SlamConfig().updated({'places.new_map_after_s': 0.2})
    world, slam = World(), RgbdSlam(CAMERA, config)
    dark = range(60, 70)
    look = 0.8 * np.sin(np.linspace(0, 2 * np.pi, 60))
    turned = np.linspace(0, np.pi, len(dark)), np.linspace(np.pi, -1.0, 100)
    twist = np.zeros((170, 6))
    twist[:, 1] = np.r_[look, *turned]
    twist[:, 3] = 0.4 * np.sin(np.linspace(0, 20, 170))
    poses = se3.exp(twist)
    maps, unknown = [], []
    for n, pose in enumerate(poses):
        result = slam.track(seen(world, n, pose, covered=n in dark))
        if result.covariance is not None:
            sigmas = np.sqrt(np.diag(result.covariance))
            assert (sigmas[:3].min() > 1) == (sigmas[3:].min() > 5)  # rad, m
            assert (sigmas[3:].min() > 5) == (not slam.odometry.is_in_main_map)
            unknown += [n] if sigmas[3:].min() > 5 else []
        slam.learn(result)  # which may join the maps
        keyframes = slam.map.atlas.keyframes
        maps.append(len(np.unique(keyframes.map_id[keyframes.indices()])))
    assert max(maps) == 2
    assert maps[-1] == 1
    assert unknown[0] == maps.index(2)  # where the new map lies in the first one
    assert (slam.stats.num_maps, slam.stats.num_merges, slam.stats.num_loops) == (1, 1, 0)
    assert len(slam.trajectory.final()) == len(slam.trajectory.online())
    errors = position_errors_m(slam.trajectory.final(), poses)
    assert errors[-30:].max() < 0.03  # back in the frame of the first map
