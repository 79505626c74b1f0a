"""Checks that the arrays of a map file form a valid map, so that no file can harm the tracker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_common import se3
from hoid_common.errors import MapFileError
from hoid_common.io.depth import is_reading
from hoid_common.io.records import Array
from hoid_common.values import NS_PER_S, CameraModel, FloatArray
from hoid_scene.dense.submap import SPAN
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.mapped_object import PlaceState
from hoid_scene.objects.object_map_state import ObjectMapState, decoded
from hoid_scene.objects.voxel_set import NUM_KEYS
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import NONE, MapState
from rgbd_slam.model.points import MAX_POSITION_M

_MAX_INTRINSICS = 18  # four, and OpenCV's 14 distortion coefficients
_MAX_IMAGES = 2.0  # chosen: largest distance of a pixel from the center, in image sizes
_MAX_STAMP_NS = 2**31 * NS_PER_S  # ROS stores seconds in 32 bits
_MAX_COUNT = 2**40  # chosen: no sum of two counts overflows
_ROUNDING = 1e-6  # chosen: by which a sum of probabilities may exceed 1
_MIN_WEIGHT, _MAX_WEIGHT = 1e-30, 1e30  # chosen: no product with a color or a coordinate overflows
_BLOCK = 64  # chosen: keyframes that are checked at once; their observations fit the cache
_MIN_RAY_M = 1e-3  # chosen: a point nearer to the camera has no viewing direction


def check_map(state: MapState, camera: CameraModel, num_octaves: int) -> None:
    """Raise MapFileError if the arrays of a map break a rule; its text names the first such rule.

    Args:
        state: The map.
        camera: The camera that the map was made with.
        num_octaves: Number of octaves of the map's features.
    """
    lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
    is_lens = len(lens) <= _MAX_INTRINSICS and np.isfinite(lens).all()
    _require(is_lens, 'its camera is invalid')
    _require(len(state) > 0 and len(state.position_m) > 0, 'it has no keyframes or no points')
    _check_keyframes(state)
    _check_tree(state)
    _check_features(state, camera, num_octaves)
    _check_points(state)
    _check_observations(state)


def check_loops(loops: Sequence[LoopEdge]) -> None:
    """Raise MapFileError if a loop edge breaks a rule; its text names this rule."""
    for edge in loops:
        _require(_are_poses(edge.T_first_second[None]), "a loop's pose is invalid")
        is_symmetric = np.allclose(edge.covariance, edge.covariance.T)
        is_positive = is_symmetric and (np.linalg.eigvalsh(edge.covariance) > 0).all()
        _require(is_positive, "a loop's covariance is invalid")
        _require(0 <= edge.num_inliers < _MAX_COUNT, "a loop's number of points is invalid")
        _require(0 <= edge.found_share < _MAX_WEIGHT, "a loop's share of points is invalid")
        _require(0 <= edge.residual_m < MAX_POSITION_M, "a loop's residual is invalid")
        _require(edge.kind.isprintable(), "a loop's kind is invalid")


def check_submaps(state: SubmapState, num_keyframes: int) -> None:
    """Raise MapFileError if the submaps of a dense map break a rule; its text names this rule.

    Args:
        state: The submaps of the dense map.
        num_keyframes: Number of keyframes of the map in the same file.
    """
    _require(_within(state.voxel_m, 1e-3, 1.0), 'the size of a voxel is out of range')
    _require(_within(state.anchor, 0, num_keyframes), 'a submap has no keyframe')
    _require(_are_poses(state.T_anchor_submap), "a submap's pose is invalid")
    _require((state.num_voxels > 0).all(), 'a submap has no voxels')
    total = int(state.num_voxels.sum(dtype=np.int64))
    _require(total == len(state.key), 'the numbers of voxels do not add up')
    _require(_within(state.key, 0, SPAN**3), 'a voxel is outside of its submap')
    is_first = np.isin(np.arange(total - 1) + 1, np.cumsum(state.num_voxels))
    _require((is_first | (np.diff(state.key) > 0)).all(), 'voxels are not sorted')
    _require(_within(state.weight, _MIN_WEIGHT, _MAX_WEIGHT), 'a weight is invalid')


def check_objects(state: ObjectMapState, num_keyframes: int) -> None:
    """Raise MapFileError if the arrays of an object map break a rule; its text names this rule.

    Args:
        state: The object map.
        num_keyframes: Number of keyframes of the map in the same file.
    """
    _require(_within(state.next_id, 1, _MAX_COUNT), 'the next number of an object is out of range')
    _require(_within(state.object_id, 1, int(state.next_id[0])), "an object's number is invalid")
    _require(len(np.unique(state.object_id)) == len(state), 'two objects have the same number')
    _require(_within(state.anchor, 0, num_keyframes), 'an object has no keyframe')
    _require(_are_poses(state.T_anchor_object), "an object's pose is invalid")
    _require(_within(state.state, 0, len(PlaceState)), "an object's state is unknown")
    for name in ('num_sightings', 'num_visible'):
        _require(_within(getattr(state, name), 1, _MAX_COUNT), f"an object's {name} is invalid")
    for name in ('first_ns', 'last_ns', 'left_ns', 'moved_ns'):
        _require(_within(getattr(state, name), 0, _MAX_STAMP_NS), 'a time stamp is out of range')
    _require(_within(state.num_through, 0, _MAX_COUNT), "an object's num_through is invalid")
    _require(_within(state.probability, 0, 1 + _ROUNDING), 'a probability is invalid')
    _require(_within(state.distance_m, 0, MAX_POSITION_M), "an object's distance is invalid")
    for vectors in (state.direction_m, state.moved_from_m):
        _require(_within(np.abs(vectors), 0, MAX_POSITION_M), 'an object has an invalid vector')
    _check_classes(state)
    _check_object_voxels(state)


def _check_classes(state: ObjectMapState) -> None:
    _require((state.num_classes > 0).all(), 'an object has no class')
    total = int(state.num_classes.sum(dtype=np.int64))
    _require(total == len(state.class_score), 'the numbers of classes do not add up')
    _require(_within(state.class_score, _MIN_WEIGHT, _MAX_WEIGHT), 'a score is invalid')
    try:
        names = [decoded(name) for name in state.class_name]
    except UnicodeDecodeError:
        names = ['']
    _require(all(name.isprintable() and name for name in names), 'the name of a class is invalid')


def _check_object_voxels(state: ObjectMapState) -> None:
    _require((state.num_voxels > 0).all(), 'an object has no voxels')
    total = int(state.num_voxels.sum(dtype=np.int64))
    _require(total == len(state.key), 'the numbers of voxels do not add up')
    _require(_within(state.key, 0, NUM_KEYS), 'a voxel is too far from its object')
    is_first = np.isin(np.arange(total - 1) + 1, np.cumsum(state.num_voxels))
    _require((is_first | (np.diff(state.key) > 0)).all(), 'voxels are not sorted')
    _require(_within(np.abs(state.means_m), 0, MAX_POSITION_M), 'a point of a voxel is invalid')
    _require(_within(state.readings, _MIN_WEIGHT, _MAX_WEIGHT), 'a number of readings is invalid')
    for counts in (state.hits, state.misses):
        _require(_within(counts, 0, _MAX_WEIGHT), 'the evidence of a voxel is invalid')


def _require(holds: bool | np.bool_, otherwise: str) -> None:
    if not holds:
        raise MapFileError(otherwise)


def _within(values: Array, low: float, end: float) -> bool:
    """Return whether all values are in [low, end): true without values, false if one is NaN."""
    return values.size == 0 or bool(values.min() >= low and values.max() < end)


def _are_poses(T: FloatArray) -> bool:
    return bool((se3.is_rigid(T) & (np.abs(T) < MAX_POSITION_M).all((1, 2))).all())


def _check_keyframes(state: MapState) -> None:
    _require(_within(state.stamp_ns, 0, _MAX_STAMP_NS), 'a time stamp is out of range')
    _require(_are_poses(state.T_map_camera), "a keyframe's pose is invalid")
    _require((state.num_features >= 0).all(), 'a number of features is negative')
    total = int(state.num_features.sum(dtype=np.int64))
    _require(total == len(state.point), 'the numbers of features do not add up')


def _check_tree(state: MapState) -> None:
    """Check that the keyframes of each map form one tree, and that map ids count from 0."""
    count = len(state)
    _require(_within(state.parent, NONE, count), 'a parent does not exist')
    is_root = state.parent == NONE
    ids = state.map_id[is_root]
    _require(
        np.array_equal(np.sort(ids), np.arange(len(ids))),
        'the number of maps is not that of roots',
    )
    _require(np.isin(state.map_id, ids).all(), 'a map has no root')
    above = np.where(is_root, np.arange(count), state.parent)
    _require((state.map_id == state.map_id[above]).all(), 'a parent is in another map')
    for _ in range(count.bit_length()):
        above = above[above]
    _require(is_root[above].all(), 'the parents of keyframes form a circle')


def _check_features(state: MapState, camera: CameraModel, num_octaves: int) -> None:
    for pixels, size_px in zip(state.uv_px.T, (camera.width_px, camera.height_px), strict=True):
        low, end = (0.5 - _MAX_IMAGES) * size_px, (0.5 + _MAX_IMAGES) * size_px
        _require(_within(pixels, low, end), "a feature's pixel is out of range")
    is_depth = (state.depth_m == 0) | is_reading(state.depth_m)
    _require(is_depth.all(), "a feature's depth is invalid")
    _require(_within(state.octave, 0, num_octaves), "a feature's octave is out of range")
    _require(_within(state.angle_deg, -360, 361), "a feature's angle is out of range")


def _check_observations(state: MapState) -> None:
    count = len(state.position_m)
    _require(_within(state.point, NONE, count), 'a feature observes a point that does not exist')
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
        _require((pairs[1:] != pairs[:-1]).all(), 'a keyframe observes one point twice')
        is_observed[point] = True
        ray = state.position_m[point] - state.T_map_camera[keyframe, :3, 3]
        _require((np.abs(ray).max(axis=1) > _MIN_RAY_M).all(), 'a point lies in the camera')
        is_same = map_id[point] == state.map_id[keyframe]
        _require(is_same.all(), 'two maps share a point')
        num_of_reference += int(np.count_nonzero(keyframe == state.reference[point]))
    _require(is_observed.all(), 'a point is observed by no keyframe')
    _require(num_of_reference == count, 'a point is not observed by its reference keyframe')


def _check_points(state: MapState) -> None:
    _require((np.abs(state.position_m) < MAX_POSITION_M).all(), 'a point is out of range')
    _require(_within(state.reference, 0, len(state)), 'a reference does not exist')
    _require(_within(state.num_found, 0, _MAX_COUNT), 'a count is out of range')
    _require(_within(state.num_visible, 0, _MAX_COUNT), 'a count is out of range')
