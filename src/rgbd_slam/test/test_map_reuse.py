"""A session loads a saved map, localizes in it, extends it, and merges its own map with it."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import MapFileError
from hoid_common.slam_status import SlamState
from hoid_common.values import CameraModel, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.map_state import MapState, snapshot
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.store.map_file import MapFile
from rgbd_slam.tracking.tracking_result import TrackingResult

from .world import CAMERA, PERIOD_NS, World, load, sway


def run(slam: RgbdSlam, world: World, poses: FloatArray, first: int = 0) -> list[TrackingResult]:
    stamps = (first + np.arange(len(poses))) * PERIOD_NS
    return [slam.process(world.features(int(ns), T)) for ns, T in zip(stamps, poses, strict=True)]


def turn(count: int, start_rad: float = 0.25, end_rad: float = -0.2) -> FloatArray:
    """Return poses in the map of the first session, beside those of that session."""
    twist = np.zeros((count, 6))
    twist[:, 1] = np.linspace(start_rad, end_rad, count)
    twist[:, 3] = np.linspace(0.3, -0.1, count)
    twist[:, 4:] = 0.05, 0.1
    return se3.exp(twist)


@pytest.fixture(scope='module')
def saved() -> MapState:
    slam = RgbdSlam(CAMERA, SlamConfig())
    run(slam, World(), sway(90))
    return snapshot(slam.map.atlas)


def errors(results: list[TrackingResult], poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position [m] and rotation [rad] errors; check that all images are tracked."""
    assert all(result.state is SlamState.TRACKING for result in results)
    estimates = np.array([result.T_map_camera for result in results])
    twists = se3.log(se3.inverse(poses) @ estimates)
    return np.linalg.norm(twists[:, 3:], axis=1), np.linalg.norm(twists[:, :3], axis=1)


def test_a_loaded_map_is_found_again_and_left_as_it_is(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig())
    slam.map.is_growing = False
    load(slam, saved)
    before = snapshot(slam.map.atlas).digest()
    assert before == saved.digest()
    poses = turn(40)
    results = run(slam, World(), poses)
    assert not any(result.is_keyframe for result in results)
    way_m, turn_rad = errors(results, poses)
    assert way_m.max() < 0.02
    assert np.degrees(turn_rad).max() < 1
    assert snapshot(slam.map.atlas).digest() == before
    assert len(slam.trajectory.keyframes()) == 0
    assert len(slam.trajectory.final()) == 40


def test_the_map_frame_stays_level_until_a_saved_map_is_used(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig())
    run(slam, World(), sway(5))
    slam.map.frames.is_level = True  # as an accelerometer has found
    config = SlamConfig().camera
    loading = slam.map.prepare_load(
        MapFile(CAMERA, config.scale_factor, config.num_octaves, saved)
    )
    assert slam.map.frames.is_level
    assert slam.map.frames.is_fixed
    slam.map.finish_load(loading)
    assert not slam.map.frames.is_level


def test_odometry_starts_at_the_first_pose_and_does_not_jump(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig())
    first = run(slam, World(), sway(90)[:10])
    load(slam, saved)
    poses = turn(20)
    results = run(slam, World(), poses, 10)
    odom = np.array([result.T_odom_camera for result in (*first, *results)])
    steps = se3.log(se3.inverse(odom[:-1]) @ odom[1:])
    assert np.linalg.norm(steps[:, 3:], axis=1).max() < 0.08
    np.testing.assert_allclose(odom[10], odom[9])  # how it got there is unknown
    assert errors(results, poses)[0].max() < 0.02
    expected = se3.inverse(poses[0]) @ poses[-1]
    np.testing.assert_allclose(se3.inverse(odom[10]) @ odom[-1], expected, atol=0.02)


def test_an_unknown_place_is_not_believed_and_localisation_stays_lost(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig())
    slam.map.is_growing = False
    load(slam, saved)
    elsewhere = World(seed=7)
    results = run(slam, elsewhere, sway(90)[:20]) + run(slam, elsewhere, sway(90)[:5], 300)
    assert all(result.state is SlamState.LOST for result in results)
    assert snapshot(slam.map.atlas).digest() == saved.digest()


def test_mapping_goes_on_in_a_loaded_map(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig())
    load(slam, saved)
    run(slam, World(), turn(60, end_rad=1.8), first=100)  # later than any image of that session
    state = snapshot(slam.map.atlas)
    kept = np.isin(state.stamp_ns, saved.stamp_ns)
    assert len(state) > kept.sum()
    assert (state.map_id == 0).all()
    # No duplicates: the known points of the room are seen, and only the rest is added.
    assert len(state.position_m) < 1.5 * len(saved.position_m)
    loaded_points = state.point[np.isin(state.keyframe, np.flatnonzero(kept))]
    first = np.flatnonzero(~kept)[np.argmin(state.stamp_ns[~kept])]  # half of it was known
    first_points = state.point[state.keyframe == first]
    shared = np.isin(first_points[first_points >= 0], loaded_points)
    assert shared.mean() > 0.6
    slam.map.finish()
    assert len(slam.trajectory.keyframes()) == len(state) - kept.sum()


def test_a_place_unknown_for_long_starts_a_map_beside_the_loaded_one(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig().updated({'places.new_map_after_s': 0.3}))
    load(slam, saved)
    results = run(slam, World(seed=7), sway(90)[:16])
    assert all(result.state is SlamState.LOST for result in results[:10])
    assert results[10].is_keyframe
    assert slam.stats.num_maps == 2
    assert not slam.odometry.is_in_main_map


@pytest.mark.slow
def test_two_sessions_are_joined_when_a_known_place_is_seen(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig())
    poses = turn(90, 1.8, -0.2)
    run(slam, World(), poses[:25])
    load(slam, saved, keep=True)
    assert slam.stats.num_maps == 2
    results = run(slam, World(), poses[25:], 25)
    assert slam.stats.num_maps == 1
    assert slam.stats.num_merges == 1
    way_m, turn_rad = errors(results[-3:], poses[-3:])
    assert way_m.max() < 0.02  # in the loaded map's frame
    assert np.degrees(turn_rad).max() < 1
    assert len(slam.trajectory.final()) == 90


@pytest.mark.slow
def test_the_mapping_process_takes_a_map_over_at_once(saved: MapState) -> None:
    slam = RgbdSlam(CAMERA, SlamConfig(), background=True)
    try:
        run(slam, World(), sway(90)[:5])
        uids = load(slam, saved)
        assert len(uids) == len(saved)
        assert snapshot(slam.map.atlas).digest() == saved.digest()
        poses = turn(60, end_rad=1.8)
        results = run(slam, World(), poses, first=100)  # later than any image of that session
        assert errors(results, poses)[0].max() < 0.02
        slam.map.finish()
        assert slam.map.mapper.is_settled
        state = snapshot(slam.map.atlas)
        assert (state.map_id == 0).all()
        # How many keyframes the mapper takes depends on its speed; it may cull loaded ones.
        assert np.isin(state.stamp_ns, saved.stamp_ns).any()
        assert (state.stamp_ns > saved.stamp_ns.max()).any()
        assert len(slam.trajectory.final()) == 60
    finally:
        slam.map.mapper.close()


@pytest.mark.parametrize(
    'camera',
    [
        CameraModel(640, 480, 545.0, 540.0, 330.0, 230.0),  # another unit
        CameraModel(320, 240, 260.0, 260.0, 160.0, 120.0),  # half the resolution
        CameraModel(848, 480, 420.0, 420.0, 424.0, 240.0),  # a wider lens
    ],
)
def test_another_camera_is_localized_in_the_map(saved: MapState, camera: CameraModel) -> None:
    config = SlamConfig().camera
    content = MapFile(CAMERA, config.scale_factor, config.num_octaves, saved)
    octaves = config.scale_factor, config.num_octaves
    slam = RgbdSlam(camera, SlamConfig())
    slam.map.is_growing = False
    load(slam, content.seen_by(camera, *octaves, extend=False).map)
    world, poses = World(), turn(20)
    results = [
        slam.process(world.features(n * PERIOD_NS, T, camera=camera)) for n, T in enumerate(poses)
    ]
    way_m, turn_rad = errors(results, poses)
    assert way_m.max() < 0.02
    assert np.degrees(turn_rad).max() < 1


def test_a_camera_that_differs_much_does_not_extend_the_map(saved: MapState) -> None:
    config = SlamConfig().camera
    content = MapFile(CAMERA, config.scale_factor, config.num_octaves, saved)
    octaves = config.scale_factor, config.num_octaves
    similar = CameraModel(640, 480, 545.0, 540.0, 330.0, 230.0)
    assert content.seen_by(CAMERA, *octaves, extend=True) is content
    assert content.seen_by(similar, *octaves, extend=True).camera == similar
    half = CameraModel(320, 240, 260.0, 260.0, 160.0, 120.0)
    with pytest.raises(MapFileError, match=r'640x480 .* 320x240 .*localize in it'):
        content.seen_by(half, *octaves, extend=True)
    with pytest.raises(MapFileError, match=r'camera\.num_octaves'):
        content.seen_by(CAMERA, config.scale_factor, 4, extend=False)


def test_in_localization_a_camera_in_a_map_that_nothing_joins_is_lost(saved: MapState) -> None:
    config = SlamConfig().updated({'places.new_map_after_s': 0.3})
    mapping, poses = RgbdSlam(CAMERA, config), sway(90)[:40]
    load(mapping, saved)
    run(mapping, World(seed=7), poses)
    assert mapping.stats.num_maps == 2
    two_maps = snapshot(mapping.map.atlas)
    for is_growing, state in ((True, SlamState.TRACKING), (False, SlamState.LOST)):
        slam = RgbdSlam(CAMERA, config)
        load(slam, two_maps)
        slam.map.is_growing = is_growing
        results = run(slam, World(seed=7), poses[20:22], first=200)
        assert [result.state for result in results] == [state] * 2
