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
)
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.model.keyframe_poses import NO_KEYFRAMES, KeyframePoses
from rgbd_slam.scene.fusion_scheduler import FusionRequest
from rgbd_slam.scene.voxel_map import ColoredCloud, DepthView, VoxelMap, in_boxes

_ROTATION_M_PER_RAD = 2.0  # a turn moves what is seen at that distance
_FAR_VOXELS = 5.0  # a correction of more than this does not wait
_SMALL_VOXELS = 0.25  # one of less is not worth fusing anew, which costs as much as fusing did
_WAIT_VIEWS, _WAIT_SHARE = 10, 1 / 3  # small ones wait for so many new views, of those kept


@dataclass(frozen=True, eq=False)
class StoredView:
    """An image that is kept to be fused anew."""

    view: DepthView
    keyframe_uid: int  # that it hangs on
    T_keyframe_camera: FloatArray  # (4, 4)
    fused_at: FloatArray | None = None  # (4, 4) T_map_camera; None while it is not in the map


class DenseMapper:
    """Keeps the voxel map in step with the keyframes.

    Images hang on keyframes. A bounded number of them is kept, those that show the most, so that
    memory follows the space seen. Those of other maps wait until these join the main one.
    """

    def __init__(self, camera: CameraModel, config: DenseConfig) -> None:
        self._config = config
        self._voxels = VoxelMap(camera, config)
        self._keyframes = NO_KEYFRAMES
        self._stored: list[StoredView] = []
        self._num_since_fused = 0

    def __len__(self) -> int:
        return len(self._voxels)

    @property
    def views(self) -> tuple[StoredView, ...]:
        """Return the images that are kept."""
        return tuple(self._stored)

    def add(
        self,
        pose: FusionRequest,
        depth_m: Float32Array,
        image_bgr: ByteArray,
        dynamic_boxes_xyxy_px: Float32Array,
    ) -> None:
        """Fuse one image; of the (N, 4) dynamic boxes nothing but that they are seen from here.

        Args:
            pose: Where it was taken, with keyframes.
        """
        margin_px = self._config.mask_margin_px
        is_dynamic = in_boxes(depth_m.shape, dynamic_boxes_xyxy_px, margin_px)
        view = self._voxels.view_of(depth_m, is_dynamic, image_bgr)
        keyframes = self._keyframes if pose.keyframes is None else pose.keyframes
        at = np.flatnonzero(keyframes.uids == pose.reference_uid)
        if len(at) == 0:
            return
        T_keyframe_camera = se3.inverse(keyframes.T_map_camera[at[0]]) @ pose.T_map_camera
        if keyframes.version >= self._keyframes.version:
            self.correct(keyframes)
        self.restore(StoredView(view, pose.reference_uid, T_keyframe_camera))

    def restore(self, view: StoredView) -> None:
        """Fuse an image that hangs on a keyframe, if that is still there."""
        at = np.flatnonzero(self._keyframes.uids == view.keyframe_uid)
        if len(at) == 0:
            return
        if self._keyframes.is_main[at[0]]:
            T_map_camera = self._keyframes.T_map_camera[at[0]] @ view.T_keyframe_camera
            self._voxels.integrate(view.view, T_map_camera)
            self._num_since_fused += 1
            view = replace(view, fused_at=T_map_camera)
        self._stored.append(view)
        if len(self._stored) > self._config.max_views:
            self._stored.pop(self._most_redundant())

    def correct(self, keyframes: KeyframePoses, *, settle: bool = False) -> bool:
        """Take the keyframes as the map says now; fuse anew if they moved enough, and say so.

        Args:
            settle: Do so for the smallest of corrections, as at the end of a run.
        """
        self._stored = _rehung(self._stored, self._keyframes, keyframes)
        self._keyframes = keyframes
        targets = self._targets()
        moved_m = max(
            (_moved_m(v.fused_at, T) for v, T in zip(self._stored, targets, strict=True)),
            default=0.0,
        )
        wait = max(_WAIT_VIEWS, _WAIT_SHARE * len(self._stored))
        is_due = self._num_since_fused >= wait or moved_m > self._limit_m(_FAR_VOXELS)
        if settle or (is_due and moved_m > self._limit_m(_SMALL_VOXELS)):
            self._fuse_anew(targets)
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
            if view.fused_at is not None:
                clear[left] = self._voxels.looks_through(points_m[left], view.view, view.fused_at)
        return clear

    def _limit_m(self, voxels: float) -> float:
        return voxels * self._config.voxel_m

    def _poses(self) -> FloatArray:
        """Return (N, 4, 4) poses of the stored views, each in the frame of its map."""
        if not self._stored:
            return np.empty((0, 4, 4))
        T = np.array([view.T_keyframe_camera for view in self._stored])
        return np.asarray(self._keyframes.T_map_camera[self._rows()] @ T)

    def _rows(self) -> IntArray:
        uids = np.array([view.keyframe_uid for view in self._stored], np.int64)
        return self._keyframes.rows_of(uids)

    def _targets(self) -> list[FloatArray | None]:
        """Return where each view belongs in the map frame, or None when that is unknown."""
        is_main = self._keyframes.is_main[self._rows()].tolist()
        return [T if main else None for T, main in zip(self._poses(), is_main, strict=True)]

    def _fuse_anew(self, targets: list[FloatArray | None]) -> None:
        self._voxels.clear()
        for view, T_map_camera in zip(self._stored, targets, strict=True):
            if T_map_camera is not None:
                self._voxels.integrate(view.view, T_map_camera)
        self._stored = [
            replace(view, fused_at=T) for view, T in zip(self._stored, targets, strict=True)
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


def _rehung(
    views: list[StoredView], before: KeyframePoses, after: KeyframePoses
) -> list[StoredView]:
    """Return the views hung on keyframes that are still there; those of maps that are gone go."""
    remaining, out = set(after.uids.tolist()), []
    for view in views:
        if view.keyframe_uid in remaining:
            out.append(view)
            continue
        old = np.flatnonzero(before.uids == view.keyframe_uid)
        near = _stand_in(before, old[0], after.uids) if len(old) else None
        if near is not None:
            T_near_old = se3.inverse(before.T_map_camera[near]) @ before.T_map_camera[old[0]]
            T_near_camera = T_near_old @ view.T_keyframe_camera
            out.append(
                replace(view, keyframe_uid=int(before.uids[near]), T_keyframe_camera=T_near_camera)
            )
    return out


def _stand_in(keyframes: KeyframePoses, gone: int, remaining_uids: IntArray) -> int | None:
    """Return the row of the keyframe of the same map made last before one, or else first."""
    same = keyframes.map_ids == keyframes.map_ids[gone]
    rows = np.flatnonzero(same & np.isin(keyframes.uids, remaining_uids))
    if len(rows) == 0:
        return None
    return int(rows[max(int(np.searchsorted(rows, gone)) - 1, 0)])


def _moved_m(before: FloatArray | None, after: FloatArray | None) -> float:
    """Return how far a moved camera moves what it sees; infinitely when it enters or leaves."""
    if before is None or after is None:
        return 0.0 if before is after else np.inf
    twist = se3.log(se3.inverse(before) @ after)
    return float(np.linalg.norm(twist[3:]) + _ROTATION_M_PER_RAD * np.linalg.norm(twist[:3]))
