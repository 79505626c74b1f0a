"""A lost camera starts a new map on new ground, and waits where something covers its view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_keyframe
from rgbd_slam.tracking.loss import NewMapPolicy

from .ring_world import CAMERA, RingWorld, mapped, ring_poses

NUM_IMAGES = 60  # in which the camera is lost, at 30 Hz
LIMIT_S = 3.0


def _lost_in(num_tracked: int, nearer: float) -> bool:
    """Return whether a map starts after a loss in a map of so many tracked images.

    Args:
        num_tracked: Images that were tracked in the first map of a session.
        nearer: Depth of what is then in view, as a share of the depth of the map.
    """
    atlas, world = Atlas(1.2, 8), RingWorld()
    poses = ring_poses(36)[:3]
    rows = mapped(atlas, world, poses, poses)
    frame: Frame = atlas.keyframes.frame(int(rows[-1]))
    last: TrackedFrame = tracked_keyframe(frame, atlas, int(atlas.keyframes.uid[rows[-1]]))
    assert np.count_nonzero(last.current_points(atlas) != NO_POINT) > 100
    policy = NewMapPolicy(atlas, CAMERA, SlamConfig())
    policy.started()
    for _ in range(num_tracked):
        policy.found(frame)
    seen = replace(frame, depth_m=nearer * frame.depth_m)
    lost_s = np.arange(1, NUM_IMAGES + 1) / 30
    return any(policy.wants(seen, last, s, LIMIT_S) for s in lost_s.tolist())


@pytest.mark.parametrize('num_tracked', [5, 30])
def test_a_hand_before_the_camera_starts_no_map(num_tracked: int) -> None:
    assert not _lost_in(num_tracked, nearer=0.3)


@pytest.mark.parametrize('num_tracked', [5, 30])
def test_new_ground_starts_a_map(num_tracked: int) -> None:
    assert _lost_in(num_tracked, nearer=3.0)
