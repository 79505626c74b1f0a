"""A frame with its estimated pose and the map points that it observes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A tracked frame; its points are identified by uids too, because rows may be reused."""

    frame: Frame
    T_map_camera: FloatArray  # (4, 4) in the map at the time of tracking
    points: IntArray  # (N,) row of the point that each feature observes, or NO_POINT
    point_uids: IntArray  # (N,) uids of these points; arbitrary where `points` is NO_POINT
    reference_uid: int  # uid of the reference keyframe, which may be pending
    T_reference_camera: FloatArray  # (4, 4)

    def current_points(self, atlas: Atlas) -> IntArray:
        """Return `points`, with NO_POINT for points that were removed from the map."""
        points = self.points
        stale = atlas.points.uid[points] != self.point_uids
        return np.where(stale | (points == NO_POINT), NO_POINT, points)

    def current_pose(self, atlas: Atlas) -> FloatArray:
        """Return T_map_camera (4, 4) by the current pose of the reference keyframe, if known."""
        T_map_reference = atlas.pose(self.reference_uid)
        if T_map_reference is None:
            return self.T_map_camera
        pose: FloatArray = T_map_reference @ self.T_reference_camera
        return pose


def tracked_frame(
    frame: Frame, T_map_camera: FloatArray, points: IntArray, atlas: Atlas, reference_uid: int
) -> TrackedFrame:
    """Return a tracked frame with its pose relative to a keyframe, whose pose must be known.

    `points` (N,) are the rows of the points that its features observe, or NO_POINT.
    """
    T_map_reference = atlas.pose(reference_uid)
    assert T_map_reference is not None
    return TrackedFrame(
        frame,
        T_map_camera,
        points,
        atlas.points.uid[points],
        reference_uid,
        se3.inverse(T_map_reference) @ T_map_camera,
    )


def tracked_keyframe(
    frame: Frame, atlas: Atlas, uid: int, unseen: BoolArray | None = None
) -> TrackedFrame:
    """Return the tracked frame of a keyframe, with its pose and points in the map.

    A pending keyframe observes no point, nor do features in the mask `unseen` (N,).
    """
    i, T_map_camera = atlas.keyframes.index_of(uid), atlas.pose(uid)
    assert T_map_camera is not None
    points = np.full(len(frame), NO_POINT) if i is None else atlas.keyframes.points_of(i)
    if unseen is not None:
        points[unseen] = NO_POINT
    return tracked_frame(frame, T_map_camera.copy(), points, atlas, uid)
