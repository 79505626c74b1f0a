"""Checks that the arrays of a map file form a valid map, which cannot harm the tracker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_common.io.depth import is_reading
from hoid_common.io.stamps import END_STAMP_NS
from hoid_common.store.checks import (
    MAX_COUNT,
    MAX_POSITION_M,
    MAX_WEIGHT,
    are_poses,
    require,
    within,
)
from hoid_common.values import CameraModel
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import NONE, MapState

_MAX_INTRINSICS = 18  # number of intrinsics: four, and OpenCV's 14 distortion coefficients
_MAX_IMAGES = 2.0  # chosen: largest distance of a pixel from the image center, in image sizes
# Chosen: number of keyframes that are checked at once, so that their observations fit the cache.
_BLOCK = 64
_MIN_RAY_M = 1e-3  # chosen: points nearer to the camera have no viewing direction


def check_map(state: MapState, camera: CameraModel, num_octaves: int) -> None:
    """Raise MapFileError, which names the first rule that the arrays of a map break."""
    lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
    is_lens = len(lens) <= _MAX_INTRINSICS and np.isfinite(lens).all()
    require(is_lens, 'its camera is invalid')
    require(len(state) > 0 and len(state.position_m) > 0, 'it has no keyframes or no points')
    _check_keyframes(state)
    _check_tree(state)
    _check_features(state, camera, num_octaves)
    _check_points(state)
    _check_observations(state)


def check_loops(loops: Sequence[LoopEdge]) -> None:
    """Raise MapFileError, which names the first rule that a loop edge breaks."""
    for edge in loops:
        require(are_poses(edge.T_first_second[None]), "a loop's pose is invalid")
        is_symmetric = np.allclose(edge.covariance, edge.covariance.T)
        is_positive = is_symmetric and (np.linalg.eigvalsh(edge.covariance) > 0).all()
        require(is_positive, "a loop's covariance is invalid")
        require(0 <= edge.num_inliers < MAX_COUNT, "a loop's number of points is invalid")
        require(0 <= edge.found_share < MAX_WEIGHT, "a loop's share of points is invalid")
        require(0 <= edge.residual_m < MAX_POSITION_M, "a loop's residual is invalid")
        require(edge.kind.isprintable(), "a loop's kind is invalid")


def _check_keyframes(state: MapState) -> None:
    require(within(state.stamp_ns, 0, END_STAMP_NS), 'a time stamp is out of range')
    require(are_poses(state.T_map_camera), "a keyframe's pose is invalid")
    require((state.num_features >= 0).all(), 'a number of features is negative')
    total = int(state.num_features.sum(dtype=np.int64))
    require(total == len(state.point), 'the numbers of features do not add up')


def _check_tree(state: MapState) -> None:
    """Check that the keyframes of each map form one tree, and that map ids count from 0."""
    count = len(state)
    require(within(state.parent, NONE, count), 'a parent does not exist')
    is_root = state.parent == NONE
    ids = state.map_id[is_root]
    require(
        np.array_equal(np.sort(ids), np.arange(len(ids))),
        'the number of maps is not that of roots',
    )
    require(np.isin(state.map_id, ids).all(), 'a map has no root')
    above = np.where(is_root, np.arange(count), state.parent)
    require((state.map_id == state.map_id[above]).all(), 'a parent is in another map')
    for _ in range(count.bit_length()):
        above = above[above]
    require(is_root[above].all(), 'the parents of keyframes form a circle')


def _check_features(state: MapState, camera: CameraModel, num_octaves: int) -> None:
    for pixels, size_px in zip(state.uv_px.T, camera.size_px, strict=True):
        low, end = (0.5 - _MAX_IMAGES) * size_px, (0.5 + _MAX_IMAGES) * size_px
        require(within(pixels, low, end), "a feature's pixel is out of range")
    is_depth = (state.depth_m == 0) | is_reading(state.depth_m)
    require(is_depth.all(), "a feature's depth is invalid")
    require(within(state.octave, 0, num_octaves), "a feature's octave is out of range")
    require(within(state.angle_deg, -360, 361), "a feature's angle is out of range")


def _check_observations(state: MapState) -> None:
    count = len(state.position_m)
    require(within(state.point, NONE, count), 'a feature observes a point that does not exist')
    is_observed, num_of_reference = np.zeros(count, np.bool_), 0
    map_id = state.map_id[state.reference]
    ends = np.cumsum(state.num_features)
    for first in range(0, len(state), _BLOCK):
        counts = state.num_features[first : first + _BLOCK]
        end = int(ends[first + len(counts) - 1])
        point = state.point[end - int(counts.sum()) : end]
        keyframe = np.repeat(np.arange(first, first + len(counts)), counts)
        keyframe, point = keyframe[point != NONE], point[point != NONE]
        pairs = np.sort(keyframe * count + point)
        require((pairs[1:] != pairs[:-1]).all(), 'a keyframe observes one point twice')
        is_observed[point] = True
        ray = state.position_m[point] - state.T_map_camera[keyframe, :3, 3]
        require((np.abs(ray).max(axis=1) > _MIN_RAY_M).all(), 'a point lies in the camera')
        is_same = map_id[point] == state.map_id[keyframe]
        require(is_same.all(), 'two maps share a point')
        num_of_reference += int(np.count_nonzero(keyframe == state.reference[point]))
    require(is_observed.all(), 'a point is observed by no keyframe')
    require(num_of_reference == count, 'a point is not observed by its reference keyframe')


def _check_points(state: MapState) -> None:
    require((np.abs(state.position_m) < MAX_POSITION_M).all(), 'a point is out of range')
    require(within(state.reference, 0, len(state)), 'a reference does not exist')
    require(within(state.num_found, 0, MAX_COUNT), 'a count is out of range')
    require(within(state.num_visible, 0, MAX_COUNT), 'a count is out of range')
