"""A frame with its estimated pose and the map points that it observes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_change import Redirect


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A frame after tracking. Rows of the map may be reused later, hence the uids."""

    frame: Frame
    T_map_camera: FloatArray  # (4, 4), by the map at the time of tracking
    points: IntArray  # (N,) row of the point that each feature observes, or NO_POINT
    point_uids: IntArray  # (N,)
    reference_uid: int  # the reference keyframe
    T_reference_camera: FloatArray  # (4, 4)

    def current_points(self, atlas: Atlas) -> IntArray:
        """Return `points`, with NO_POINT for those that have been removed from the map."""
        points = self.points
        stale = atlas.points.uid[points] != self.point_uids
        return np.where(stale | (points == NO_POINT), NO_POINT, points)

    def current_pose(self, atlas: Atlas) -> FloatArray:
        """Return T_map_camera (4, 4) by the current map."""
        keyframes = atlas.keyframes
        i = keyframes.index_of(self.reference_uid)
        if i is None:
            return self.T_map_camera
        pose: FloatArray = keyframes.T_map_camera[i] @ self.T_reference_camera
        return pose

    def redirected(self, redirects: Iterable[Redirect]) -> TrackedFrame:
        """Return the frame relative to the parent, if its reference keyframe was removed."""
        uid, T = self.reference_uid, self.T_reference_camera
        for redirect in redirects:
            if redirect.uid == uid:
                uid, T = redirect.parent_uid, redirect.T_parent_camera @ T
        return replace(self, reference_uid=uid, T_reference_camera=T)


def tracked_frame(
    frame: Frame, T_map_camera: FloatArray, points: IntArray, atlas: Atlas, reference: int
) -> TrackedFrame:
    """Return a tracked frame whose pose is relative to keyframe `reference`."""
    keyframes = atlas.keyframes
    return TrackedFrame(
        frame,
        T_map_camera,
        points,
        atlas.points.uid[points],
        int(keyframes.uid[reference]),
        se3.inverse(keyframes.T_map_camera[reference]) @ T_map_camera,
    )


def tracked_keyframe(
    frame: Frame, atlas: Atlas, i: int, unseen: BoolArray | None = None
) -> TrackedFrame:
    """Return the tracked frame of keyframe `i`, with the pose and points that the map has.

    Args:
        frame: The frame that became the keyframe.
        atlas: The map.
        i: Row of the keyframe.
        unseen: (N,) mask of features whose observations are left out, although the map has them.
    """
    points = atlas.keyframes.points_of(i)
    if unseen is not None:
        points[unseen] = NO_POINT
    return tracked_frame(frame, atlas.keyframes.T_map_camera[i].copy(), points, atlas, i)
