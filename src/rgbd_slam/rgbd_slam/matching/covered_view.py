"""Test whether something in front of a lost camera, such as a person, hides the map."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray, IntArray
from rgbd_slam.matching.local_map import find_local_map, visible_points
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame

_CELL_PX = 80.0  # chosen: side of the image cells in which depths are compared
# Chosen: a surface hides a map point if the point's depth is more than 1.25 times that of the
# surface. The camera motion between two images changes depths by less.
_HIDDEN_RATIO = 1.25
# Chosen: a view is covered if more than this ratio of the map points in view is hidden.
_COVERED_SHARE = 0.5


def is_view_covered(
    atlas: Atlas, camera: StereoCamera, frame: Frame, last: TrackedFrame, max_keyframes: int
) -> bool:
    """Return whether a lost frame shows a surface that hides most map points in the last view."""
    T_camera_map, seen = last.current_pose(atlas), last.current_points(atlas)
    local_map = find_local_map(atlas, seen[seen != NO_POINT], last.reference_uid, max_keyframes)
    view = visible_points(atlas, camera, T_camera_map, local_map.points, radius=1.0)
    k = np.flatnonzero(frame.has_depth)
    if not len(k) or not len(view.points):
        return False
    pixels = np.hstack([frame.measurement_px[k, :2].T, view.queries.projection_px[:2]])
    cells = _cells(camera, pixels)
    of_feature, of_point = cells[: len(k)], cells[len(k) :]
    count = np.bincount(of_feature, minlength=cells.max() + 1)
    sum_per_m = np.bincount(of_feature, 1.0 / frame.depth_m[k], cells.max() + 1)
    has_surface = count[of_point] > 0
    of_point, points = of_point[has_surface], view.points[has_surface]
    point_m = atlas.points.position_m[points] @ T_camera_map[2, :3] + T_camera_map[2, 3]
    is_hidden = point_m * sum_per_m[of_point] / count[of_point] > _HIDDEN_RATIO
    return bool(is_hidden.sum() > _COVERED_SHARE * len(view.points))


def _cells(camera: StereoCamera, pixels: FloatArray) -> IntArray:
    """Return the index (N,) of the image cell of each pixel (2, N)."""
    left, top, right, _ = camera.bounds_px
    column, row = np.maximum((pixels - np.array([[left], [top]])) // _CELL_PX, 0.0)
    return np.asarray(row * np.ceil((right - left) / _CELL_PX + 1) + column, np.int64)
