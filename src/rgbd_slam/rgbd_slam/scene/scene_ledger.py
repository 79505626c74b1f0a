"""The ledger of the scene: which images were integrated into its maps, and at which poses.

All maps of the scene are made of the same images. The ledger stores these relative to keyframes,
follows the corrections of the keyframes, and lets every consumer integrate each image once, at
the same pose in the map frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.model.keyframe_poses import NO_KEYFRAMES, KeyframePoses
from rgbd_slam.scene.scene_scheduler import SceneRequest
from rgbd_slam.scene.stored_view import StoredView, ViewChange, halved
from rgbd_slam.scene.voxel_map import DepthView

# Chosen: distance [m] at which a rotation is compared with a translation, typical of what a
# camera sees in a room.
_ROTATION_M_PER_RAD = 2.0
# Rebuilding costs as much as all integrations before it. None of these numbers was tuned.
_LARGE_VOXELS = 5.0  # a correction of more voxels than this rebuilds at once
_SMALL_VOXELS = 0.25  # a correction of fewer voxels than this never does: a voxel hides it
_WAIT_VIEWS, _WAIT_SHARE = 10, 1 / 3  # others wait for this many, and this share of, new views


class SceneConsumer(Protocol):
    """A map of the scene that is made of the stored images, such as the voxels.

    A consumer keeps no pose and no image: the ledger calls it with both, again after corrections.
    """

    def integrate(self, view: DepthView, T_map_camera: FloatArray) -> None:
        """Add an image that was taken at a pose (4, 4)."""

    def clear(self) -> None:
        """Discard everything: all images follow again at corrected poses."""


class SceneLedger:
    """Stores images relative to keyframes, and keeps the consumers consistent with both.

    The number of images is bounded; the most redundant one is removed first, so that memory grows
    with the space seen. Images of other maps than the main one wait, stored but not integrated,
    until a recognized place merges these maps.

    Args:
        consumers: The maps that are made of the images.
        config: Gives the number of images and the size of a voxel.
    """

    def __init__(self, consumers: Sequence[SceneConsumer], config: DenseConfig) -> None:
        self._consumers, self._config = consumers, config
        self._keyframes = NO_KEYFRAMES
        self._stored: list[StoredView] = []
        self._reported: dict[int, StoredView] = {}  # by slot, as of the last `take_changes`
        self._next_slot = 0
        self._num_since_rebuild = 0

    @property
    def views(self) -> tuple[StoredView, ...]:
        """Return the stored images."""
        return tuple(self._stored)

    def integrated(self) -> Iterator[tuple[DepthView, FloatArray]]:
        """Yield the images in the consumers with T_map_camera (4, 4), the newest first."""
        for stored in reversed(self._stored):
            if stored.integrated_at is not None:
                yield stored.view, stored.integrated_at

    def add(self, request: SceneRequest, view: DepthView) -> None:
        """Store and integrate an image, unless its keyframe has been removed since the request."""
        keyframes = self._keyframes if request.keyframes is None else request.keyframes
        rows = np.flatnonzero(keyframes.uids == request.reference_uid)
        if len(rows) == 0:
            return
        T_keyframe_camera = se3.inverse(keyframes.T_map_camera[rows[0]]) @ request.T_map_camera
        if keyframes.version >= self._keyframes.version:
            self.correct(keyframes)
        self.restore(StoredView(view, request.reference_uid, T_keyframe_camera))

    def restore(self, view: StoredView) -> None:
        """Store and integrate an image of a saved map, unless its keyframe does not exist.

        A view with a slot was reported by the ledger of a process that has died; it keeps its slot
        and is not reported again.
        """
        if view.slot >= 0:
            self._reported[view.slot] = view
        else:
            view = replace(view, slot=self._next_slot)
        self._next_slot = max(self._next_slot, view.slot + 1)
        rows = np.flatnonzero(self._keyframes.uids == view.keyframe_uid)
        if len(rows) == 0:
            return
        if self._keyframes.is_main[rows[0]]:
            T_map_camera = self._keyframes.T_map_camera[rows[0]] @ view.T_keyframe_camera
            self._integrate(view, T_map_camera)
            self._num_since_rebuild += 1
            view = replace(view, integrated_at=T_map_camera)
        self._stored.append(view)
        if len(self._stored) > self._config.max_views:
            self._stored.pop(self._most_redundant())

    def correct(self, keyframes: KeyframePoses, *, force: bool = False) -> bool:
        """Apply corrected keyframe poses; rebuild the consumers if the images moved enough.

        Args:
            keyframes: The poses of all keyframes.
            force: Rebuild after corrections of any size, as at the end of a run.

        Returns:
            Whether the consumers were rebuilt.
        """
        self._stored = _reattached(self._stored, self._keyframes, keyframes)
        self._keyframes = keyframes
        targets = self._targets()
        pairs = zip(self._stored, targets, strict=True)
        moved_m = max((_moved_m(v.integrated_at, T) for v, T in pairs), default=0.0)
        wait = max(_WAIT_VIEWS, _WAIT_SHARE * len(self._stored))
        voxel_m = self._config.voxel_m
        is_due = self._num_since_rebuild >= wait or moved_m > _LARGE_VOXELS * voxel_m
        if force or (is_due and moved_m > _SMALL_VOXELS * voxel_m):
            self._rebuild(targets)
            return True
        return False

    def clear(self) -> None:
        """Discard all images."""
        self._stored = []
        self._rebuild([])

    def take_changes(self) -> Iterator[ViewChange]:
        """Yield the changes of the stored images since the last call."""
        before, self._reported = self._reported, {view.slot: view for view in self._stored}
        for slot, view in self._reported.items():
            old = before.pop(slot, None)
            attached = view.keyframe_uid, view.T_keyframe_camera
            if old is None:
                image = DepthView(view.view.flagged_mm, halved(view.view.image_bgr))
                yield ViewChange(slot, attached, image)
            elif old.T_keyframe_camera is not view.T_keyframe_camera:
                yield ViewChange(slot, attached)
        for slot in before:
            yield ViewChange(slot, None)

    def _integrate(self, stored: StoredView, T_map_camera: FloatArray) -> None:
        for consumer in self._consumers:
            consumer.integrate(stored.view, T_map_camera)

    def _rebuild(self, targets: list[FloatArray | None]) -> None:
        for consumer in self._consumers:
            consumer.clear()
        for stored, T_map_camera in zip(self._stored, targets, strict=True):
            if T_map_camera is not None:
                self._integrate(stored, T_map_camera)
        pairs = zip(self._stored, targets, strict=True)
        self._stored = [replace(stored, integrated_at=T) for stored, T in pairs]
        self._num_since_rebuild = 0

    def _rows(self) -> IntArray:
        uids = np.array([view.keyframe_uid for view in self._stored], np.int64)
        return self._keyframes.rows_of(uids)

    def _poses(self) -> FloatArray:
        """Return the (N, 4, 4) poses of the stored images, each in the frame of its own map."""
        if not self._stored:
            return np.empty((0, 4, 4))
        T = np.array([view.T_keyframe_camera for view in self._stored])
        return np.asarray(self._keyframes.T_map_camera[self._rows()] @ T)

    def _targets(self) -> list[FloatArray | None]:
        """Return each image's T_map_camera (4, 4), or None where it is in another map."""
        is_main = self._keyframes.is_main[self._rows()].tolist()
        return [T if main else None for T, main in zip(self._poses(), is_main, strict=True)]

    def _most_redundant(self) -> int:
        """Return the index of the older one of the two images with the most similar poses."""
        T = self._poses()
        gap = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=2)
        cosine = np.clip(np.einsum('ik,jk->ij', T[:, :3, 2], T[:, :3, 2]), -1, 1)
        gap += _ROTATION_M_PER_RAD * np.arccos(cosine)
        gap[np.tril_indices(len(gap))] = np.inf
        return int(np.unravel_index(np.argmin(gap), gap.shape)[0])


def _reattached(
    views: list[StoredView], before: KeyframePoses, after: KeyframePoses
) -> list[StoredView]:
    """Return the views, attached to other keyframes of the same map where theirs were removed.

    The views of a map that was removed are left out.
    """
    remaining, out = set(after.uids.tolist()), []
    for view in views:
        if view.keyframe_uid in remaining:
            out.append(view)
            continue
        old = np.flatnonzero(before.uids == view.keyframe_uid)
        near = _substitute(before, old[0], after.uids) if len(old) else None
        if near is not None:
            T_near_old = se3.inverse(before.T_map_camera[near]) @ before.T_map_camera[old[0]]
            T_near_camera = T_near_old @ view.T_keyframe_camera
            uid = int(before.uids[near])
            out.append(replace(view, keyframe_uid=uid, T_keyframe_camera=T_near_camera))
    return out


def _substitute(keyframes: KeyframePoses, removed: int, remaining_uids: IntArray) -> int | None:
    """Return the row of the keyframe of the same map that precedes a removed one, or the first."""
    same = keyframes.map_ids == keyframes.map_ids[removed]
    rows = np.flatnonzero(same & np.isin(keyframes.uids, remaining_uids))
    if len(rows) == 0:
        return None
    return int(rows[max(int(np.searchsorted(rows, removed)) - 1, 0)])


def _moved_m(before: FloatArray | None, after: FloatArray | None) -> float:
    """Return by how much what a camera sees moves with it; inf if it enters or leaves the map."""
    if before is None or after is None:
        return 0.0 if before is after else np.inf
    twist = se3.log(se3.inverse(before) @ after)
    return float(np.linalg.norm(twist[3:]) + _ROTATION_M_PER_RAD * np.linalg.norm(twist[:3]))
