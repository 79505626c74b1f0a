"""Dense mapping: fuse images as they come, fuse anew when the keyframes have been corrected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import ByteArray, CameraModel, Float32Array, FloatArray
from rgbd_slam.dense.config import DenseConfig
from rgbd_slam.dense.voxel_map import ColoredCloud, DepthView, VoxelMap, mask_boxes

_MOVED_M = 0.5  # in voxels: a keyframe moved by more than this share makes the fused map wrong
_MOVED_RAD = 0.01


@dataclass(frozen=True, eq=False)
class _StoredView:
    view: DepthView
    T_keyframe_camera: FloatArray
    fused_at: FloatArray  # T_map_keyframe when it was fused


class DenseMapper:
    """Keeps the voxel map in step with the keyframes.

    Images hang on their reference keyframe. One image a keyframe is kept, so that memory
    follows the space seen.
    """

    def __init__(self, camera: CameraModel, config: DenseConfig) -> None:
        self._config = config
        self._voxels = VoxelMap(camera, config)
        self._stored: dict[int, _StoredView] = {}

    def __len__(self) -> int:
        return len(self._voxels)

    def add(
        self,
        depth_m: Float32Array,
        image_bgr: ByteArray,
        dynamic_boxes_xyxy_px: Float32Array,
        keyframe_id: int,
        T_map_keyframe: FloatArray,
        T_keyframe_camera: FloatArray,
    ) -> None:
        """Fuse one image, leaving out the (N, 4) dynamic boxes."""
        static_m = mask_boxes(depth_m, dynamic_boxes_xyxy_px, self._config.mask_margin_px)
        view = self._voxels.view_of(static_m, image_bgr)
        self._voxels.integrate(view, T_map_keyframe @ T_keyframe_camera)
        self._stored.pop(keyframe_id, None)  # the latest view of a keyframe is the one kept
        self._stored[keyframe_id] = _StoredView(view, T_keyframe_camera, T_map_keyframe)
        if len(self._stored) > self._config.max_views:
            self._stored.pop(next(iter(self._stored)))

    def correct(self, T_map_keyframes: Mapping[int, FloatArray]) -> bool:
        """Take corrected keyframe poses; fuse anew if they moved enough, and say so."""
        kept = {i: view for i, view in self._stored.items() if i in T_map_keyframes}
        moved = any(self._has_moved(v.fused_at, T_map_keyframes[i]) for i, v in kept.items())
        if not moved:
            return False
        self._voxels.clear()
        self._stored = {}
        for i, stored in kept.items():
            self._voxels.integrate(stored.view, T_map_keyframes[i] @ stored.T_keyframe_camera)
            self._stored[i] = _StoredView(
                stored.view, stored.T_keyframe_camera, T_map_keyframes[i]
            )
        return True

    def cloud(self) -> ColoredCloud:
        """Return the map's points in the map frame."""
        return self._voxels.cloud()

    def clear(self) -> None:
        """Forget the map."""
        self._voxels.clear()
        self._stored = {}

    def _has_moved(self, before: FloatArray, after: FloatArray) -> bool:
        twist = se3.log(se3.inverse(before) @ after)
        far = np.linalg.norm(twist[3:]) > _MOVED_M * self._config.voxel_m
        return bool(far or np.linalg.norm(twist[:3]) > _MOVED_RAD)
