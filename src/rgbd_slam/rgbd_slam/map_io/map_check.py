"""Whether the arrays of a map file make a map: whatever a file says, the tracker stays safe."""

from __future__ import annotations

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.io.record import Array
from hoid_common.values import NS_PER_S, CameraModel, FloatArray
from rgbd_slam.model.map_state import NONE, MapState
from rgbd_slam.scene.dense_state import DenseState

_MOST_M = 1e5  # from the origin
_MOST_INTRINSICS = 18
_MOST_IMAGES = 2.0  # that undistortion may move a pixel
_MOST_STAMP_NS = 2**31 * NS_PER_S  # of ROS: seconds in 32 bits
_MOST_COUNT = 2**40
_ORTHONORMAL = 1e-6
_NEAREST_M = 1e-3


def check_map(state: MapState, camera: CameraModel, num_octaves: int) -> None:
    """Raise MapFileError with what is wrong, if anything is."""
    lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
    is_lens = len(lens) <= _MOST_INTRINSICS and np.isfinite(lens).all()
    _require(is_lens, 'its camera is none')
    _require(len(state) > 0 and len(state.position_m) > 0, 'it has no keyframes or no points')
    _check_keyframes(state)
    _check_tree(state)
    _check_features(state, camera, num_octaves)
    _check_points(state)
    _check_observations(state)


def check_dense(state: DenseState, num_keyframes: int) -> None:
    """Raise MapFileError with what is wrong, if anything is."""
    _require(_within(state.keyframe, 0, num_keyframes), 'an image hangs on no keyframe')
    _require(_are_poses(state.T_keyframe_camera), "an image's pose is none")
    whole, half = state.flagged_mm.shape[1:], state.image_bgr.shape[1:3]
    _require(half == tuple((n + 1) // 2 for n in whole), 'depth and colour differ in size')


def _require(holds: bool | np.bool_, otherwise: str) -> None:
    if not holds:
        raise MapFileError(otherwise)


def _within(values: Array, low: float, end: float) -> bool:
    """Return whether all are numbers in [low, end)."""
    return bool(((values >= low) & (values < end)).all())


def _are_poses(T: FloatArray) -> bool:
    if not (np.abs(T) < _MOST_M).all():  # neither is NaN
        return False
    R = T[:, :3, :3]
    errors = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3))
    is_rigid = (errors < _ORTHONORMAL).all() and (np.linalg.det(R) > 0).all()
    return bool(is_rigid and (T[:, 3] == (0, 0, 0, 1)).all())


def _check_keyframes(state: MapState) -> None:
    _require(_within(state.stamp_ns, 0, _MOST_STAMP_NS), 'a time stamp is out of range')
    _require(_are_poses(state.T_map_camera), "a keyframe's pose is none")
    _require((state.num_features >= 0).all(), 'a number of features is negative')
    total = int(state.num_features.sum(dtype=np.int64))
    _require(total == len(state.point), 'keyframes and features disagree in number')


def _check_tree(state: MapState) -> None:
    """The keyframes of each map hang on one of them, its root."""
    count = len(state)
    _require(_within(state.parent, NONE, count), 'a keyframe hangs on none that is there')
    is_root = state.parent == NONE
    ids = state.map_id[is_root]
    _require(np.array_equal(np.sort(ids), np.arange(len(ids))), 'maps and roots disagree')
    _require(np.isin(state.map_id, ids).all(), 'a map has no root')
    above = np.where(is_root, np.arange(count), state.parent)
    _require((state.map_id == state.map_id[above]).all(), 'a keyframe hangs on one of another map')
    for _ in range(count.bit_length()):
        above = above[above]
    _require(is_root[above].all(), 'keyframes hang on each other in a circle')


def _check_features(state: MapState, camera: CameraModel, num_octaves: int) -> None:
    size_px = np.array([camera.width_px, camera.height_px])
    is_near = (np.abs(state.uv_px - size_px / 2) < _MOST_IMAGES * size_px).all()
    _require(is_near, "a feature's pixel is out of range")
    near = (state.depth_m > 0) & (state.depth_m < _NEAREST_M)
    _require(_within(state.depth_m, 0, _MOST_M) and not near.any(), "a feature's depth is none")
    _require(_within(state.octave, 0, num_octaves), "a feature's octave is out of range")
    _require(_within(state.angle_deg, -360, 361), "a feature's angle is out of range")


def _check_observations(state: MapState) -> None:
    count = len(state.position_m)
    _require(_within(state.point, NONE, count), 'a feature sees a point that is not there')
    seen = state.point != NONE
    keyframe, point = state.keyframe[seen], state.point[seen]
    pairs = keyframe * count + point
    _require(len(np.unique(pairs)) == len(pairs), 'a keyframe sees one point twice')
    _require((np.bincount(point, minlength=count) > 0).all(), 'a point is seen by no keyframe')
    ray = state.position_m[point] - state.T_map_camera[keyframe, :3, 3]
    _require((np.abs(ray).max(axis=1) > _NEAREST_M).all(), 'a point lies in the camera')
    map_id = state.map_id[state.reference]
    _require((map_id[point] == state.map_id[keyframe]).all(), 'two maps share a point')
    of_reference = point[keyframe == state.reference[point]]
    _require(len(of_reference) == count, 'a point is not seen by its reference')


def _check_points(state: MapState) -> None:
    _require((np.abs(state.position_m) < _MOST_M).all(), 'a point is out of range')
    _require(_within(state.reference, 0, len(state)), 'a point has a reference that is not there')
    _require(_within(state.num_found, 0, _MOST_COUNT), 'a count is out of range')
    _require(_within(state.num_visible, 0, _MOST_COUNT), 'a count is out of range')
