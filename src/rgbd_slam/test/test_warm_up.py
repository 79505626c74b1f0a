"""The poses of the first frames of a map are corrected once static points are known."""

from __future__ import annotations

import numpy as np

from hoid_common.slam_status import SlamState
from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA, PERIOD_NS, World, position_errors_m, sway

POSES = sway(90)
FIRST = slice(1, NS_PER_S // PERIOD_NS)  # the root holds the map's frame
GOES_M = np.array([0.006, 0.0, 0.0])  # an image, what moves
LEAVES = 12  # images


def first_errors_m(slam: RgbdSlam, kind: str) -> FloatArray:
    return position_errors_m(getattr(slam.trajectory, kind)(), POSES)[FIRST]


def slam_with_a_mover(config: SlamConfig) -> RgbdSlam:
    """Track a scene in which a sixth of the points moves at first and then disappears."""
    world, slam = World(), RgbdSlam(CAMERA, config)
    moves = np.arange(len(world.points_m)) % 6 == 0
    world.points_m[moves] *= 0.5  # near the camera
    for n, pose in enumerate(POSES):
        if n < LEAVES:
            world.points_m[moves] += GOES_M
        elif n == LEAVES:
            world.points_m[moves] = [0.0, 0.0, -100.0]
        state = slam.process(world.features(n * PERIOD_NS, pose)).state
        assert state is SlamState.TRACKING
    slam.map.finish()
    return slam


def test_a_moving_object_at_the_start_is_removed_from_the_first_poses() -> None:
    slam = slam_with_a_mover(SlamConfig())
    assert first_errors_m(slam, 'online').max() > 0.015  # published at the time, and not corrected
    final = first_errors_m(slam, 'final')
    assert final.max() < 0.006
    assert np.sqrt((final**2).mean()) < 0.003


def test_without_the_consensus_nothing_is_corrected() -> None:
    slam = slam_with_a_mover(SlamConfig().updated({'tracking.consensus.enabled': False}))
    before = slice(5)  # the second keyframe, which moves others
    online, final = (first_errors_m(slam, kind)[before] for kind in ('online', 'final'))
    np.testing.assert_allclose(final, online, atol=1e-9)
    assert final.max() > 0.04


def test_a_map_of_two_seconds_keeps_its_online_poses() -> None:
    world, slam = World(), RgbdSlam(CAMERA, SlamConfig())
    for n in range(5):
        slam.process(world.features(n * PERIOD_NS, POSES[n]))
    online, final = slam.trajectory.online(), slam.trajectory.final()
    np.testing.assert_allclose(final.T_world_camera, online.T_world_camera, atol=1e-9)
