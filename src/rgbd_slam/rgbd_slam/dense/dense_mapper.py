"""Dense mapping: fuse images as they come, fuse anew when the keyframes have been corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hoid_common import se3
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
    Trajectory,
)
from rgbd_slam.dense.config import DenseConfig
from rgbd_slam.dense.voxel_map import ColoredCloud, DepthView, VoxelMap, mask_boxes
from rgbd_slam.frame_poses import FramePose

_ROTATION_M_PER_RAD = 2.0  # a turn moves what is seen at that distance
_FAR_VOXELS = 5.0  # a correction of more than this does not wait
_SMALL_VOXELS = 0.25  # one of less is not worth fusing anew, which costs as much as fusing did
_WAIT_VIEWS, _WAIT_SHARE = 10, 1 / 3  # small ones wait for so many new views, of those kept


@dataclass(frozen=True, eq=False)
class _StoredView:
    stamp_ns: int
    view: DepthView
    keyframe_ns: int  # its reference keyframe, by stamp
    T_keyframe_camera: FloatArray
    fused_at: FloatArray  # T_map_camera


class DenseMapper:
    """Keeps the voxel map in step with the keyframes.

    Images hang on the keyframe nearest in time. A bounded number of them is kept, those that show
    the most, so that memory follows the space seen.
    """

    def __init__(self, camera: CameraModel, config: DenseConfig) -> None:
        self._config = config
        self._voxels = VoxelMap(camera, config)
        self._keyframes = Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4)))
        self._stored: list[_StoredView] = []
        self._num_since_fused = 0

    def __len__(self) -> int:
        return len(self._voxels)

    @property
    def num_views(self) -> int:
        """Return how many images are kept."""
        return len(self._stored)

    def add(
        self,
        pose: FramePose,
        depth_m: Float32Array,
        image_bgr: ByteArray,
        dynamic_boxes_xyxy_px: Float32Array,
    ) -> None:
        """Fuse one image, leaving out the (N, 4) dynamic boxes.

        Args:
            pose: Where it was taken, with keyframes.
        """
        if pose.keyframes is not None:
            self.correct(pose.keyframes)
        static_m = mask_boxes(depth_m, dynamic_boxes_xyxy_px, self._config.mask_margin_px)
        view = self._voxels.view_of(static_m, image_bgr)
        self._voxels.integrate(view, pose.T_map_camera)
        self._num_since_fused += 1
        if len(self._keyframes) == 0:
            return
        near = _nearest(self._keyframes.stamps_ns, pose.stamp_ns)
        self._stored.append(
            _StoredView(
                pose.stamp_ns,
                view,
                int(self._keyframes.stamps_ns[near]),
                se3.inverse(self._keyframes.T_world_camera[near]) @ pose.T_map_camera,
                pose.T_map_camera,
            )
        )
        if len(self._stored) > self._config.max_views:
            self._stored.pop(self._most_redundant())

    def correct(self, keyframes: Trajectory, *, settle: bool = False) -> bool:
        """Take the keyframes as the map says now; fuse anew if they moved enough, and say so.

        Args:
            settle: Do so for the smallest of corrections, as at the end of a run.
        """
        self._stored = _rehung(self._stored, self._keyframes, keyframes)
        self._keyframes = keyframes
        poses = self._poses()
        moved_m = max(
            (_moved_m(v.fused_at, T) for v, T in zip(self._stored, poses, strict=True)),
            default=0.0,
        )
        wait = max(_WAIT_VIEWS, _WAIT_SHARE * len(self._stored))
        is_due = self._num_since_fused >= wait or moved_m > self._limit_m(_FAR_VOXELS)
        if settle or (is_due and moved_m > self._limit_m(_SMALL_VOXELS)):
            self._fuse_anew(poses)
            return True
        return False

    def cloud(self) -> ColoredCloud:
        """Return the map's points in the map frame."""
        return self._voxels.cloud()

    def doubtful_m(self) -> FloatArray:
        """Return (N, 3) what was measured, but not by enough images to be shown."""
        return self._voxels.doubtful_m()

    def is_clear(self, points_m: FloatArray) -> BoolArray:
        """Return which of (N, 3) points were seen to be free in one of the images kept."""
        clear = np.zeros(len(points_m), np.bool_)
        for view in reversed(self._stored):
            left = np.flatnonzero(~clear)
            if len(left) == 0:
                break
            clear[left] = self._voxels.looks_through(points_m[left], view.view, view.fused_at)
        return clear

    def _limit_m(self, voxels: float) -> float:
        return voxels * self._config.voxel_m

    def _poses(self) -> FloatArray:
        """Return (N, 4, 4) T_map_camera of the stored views by the keyframes as they are now."""
        if not self._stored:
            return np.empty((0, 4, 4))
        stamps = np.array([view.keyframe_ns for view in self._stored], np.int64)
        rows = np.searchsorted(self._keyframes.stamps_ns, stamps)
        T = np.array([view.T_keyframe_camera for view in self._stored])
        return np.asarray(self._keyframes.T_world_camera[rows] @ T)

    def _fuse_anew(self, poses: FloatArray) -> None:
        self._voxels.clear()
        for view, T_map_camera in zip(self._stored, poses, strict=True):
            self._voxels.integrate(view.view, T_map_camera)
        self._stored = [
            replace(view, fused_at=T) for view, T in zip(self._stored, poses, strict=True)
        ]
        self._num_since_fused = 0

    def _most_redundant(self) -> int:
        """Return the older of the two views that are nearest to each other in space."""
        T = self._poses()
        gap = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=2)
        cosine = np.clip(np.einsum('ik,jk->ij', T[:, :3, 2], T[:, :3, 2]), -1, 1)
        gap += _ROTATION_M_PER_RAD * np.arccos(cosine)
        gap[np.tril_indices(len(gap))] = np.inf
        return int(np.unravel_index(np.argmin(gap), gap.shape)[0])


def _nearest(stamps_ns: IntArray, stamp_ns: int) -> int:
    return int(np.argmin(np.abs(stamps_ns - stamp_ns)))


def _rehung(views: list[_StoredView], before: Trajectory, after: Trajectory) -> list[_StoredView]:
    """Return the views hung on keyframes that are still there; those of another map go."""
    common = np.isin(before.stamps_ns, after.stamps_ns)
    stamps, poses = before.stamps_ns[common], before.T_world_camera[common]
    if len(stamps) == 0:
        return []
    remaining, out = set(stamps.tolist()), []
    for view in views:
        if view.keyframe_ns in remaining:
            out.append(view)
            continue
        old = before.T_world_camera[np.searchsorted(before.stamps_ns, view.keyframe_ns)]
        near = _nearest(stamps, view.stamp_ns)
        T_near_camera = se3.inverse(poses[near]) @ old @ view.T_keyframe_camera
        out.append(replace(view, keyframe_ns=int(stamps[near]), T_keyframe_camera=T_near_camera))
    return out


def _moved_m(before: FloatArray, after: FloatArray) -> float:
    """Return how far a moved camera moves what it sees."""
    twist = se3.log(se3.inverse(before) @ after)
    return float(np.linalg.norm(twist[3:]) + _ROTATION_M_PER_RAD * np.linalg.norm(twist[:3]))
