"""The ledger of the scene: the stored images from which the submaps of the dense map are made.

The ledger stores the pose of each image relative to a keyframe, and follows the corrections of the
keyframes. A correction first moves each submap rigidly with its anchor keyframe. A submap whose
images have moved relative to it is bent, if enough of them are still stored: its voxels are made
again from them. The voxels of loaded submaps have no images: they only move with their anchor
keyframe, and new images carve those that are wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from hoid_common import se3
from hoid_common.poses.keyframe_poses import NO_KEYFRAMES, KeyframePoses
from hoid_common.values import FloatArray, IntArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.depth_view import DepthView
from hoid_scene.dense.stored_view import StoredView, ViewChange, ViewFile
from hoid_scene.dense.view_folder import ViewFolder
from hoid_scene.dense.voxel_map import PosedView, VoxelMap
from hoid_scene.scene_scheduler import SceneRequest

# Chosen: distance [m] at which a rotation is compared with a translation, typical of what a
# camera sees in a room.
_ROTATION_M_PER_RAD = 2.0
_BENT_VOXELS = 0.5  # a smaller displacement is hidden by a voxel; not tuned
_FORCED_VOXELS = 0.05  # the same at a forced correction, as at the end of a run
# Largest number of stored images within this distance of a new one; if there are more, the most
# redundant one is removed. A camera that drives past stores 6 images per meter; a voxel needs 3.
# Not tuned.
_NEAR_M, _MAX_NEAR = 2.0, 100
# Not tuned: a submap is rebuilt only if this share of its images, or this number, is still stored.
_MIN_SHARE, _ENOUGH = 0.5, 10
_REGION_M = 3.0  # radius; chosen: bounds the time to fuse one region again to about 2 s


class SceneLedger:
    """Stores images relative to keyframes, and keeps the voxels consistent with both.

    The images are in files. Their number grows with the space that was seen, and not with time.

    Args:
        voxels: The dense map that is made of the images.
        config: Gives the size of a voxel.
        folder: Folder for the files of the images; None: a temporary one.
    """

    def __init__(self, voxels: VoxelMap, config: DenseConfig, folder: Path | None = None) -> None:
        self._voxels, self._config = voxels, config
        if folder is None:
            self._own_folder = ViewFolder()
            folder = self._own_folder.path
        self._folder = folder
        self._keyframes = NO_KEYFRAMES
        self._views: dict[int, StoredView] = {}  # by slot, in the order of storing
        self._reported: dict[int, StoredView] = {}  # as of the last `take_changes`
        self._next_slot = 0
        self._camera_m = np.zeros(3)  # position of the camera at the last image, map frame

    @property
    def views(self) -> tuple[StoredView, ...]:
        """Return the stored images in the order of storing."""
        return tuple(self._views.values())

    @property
    def keyframes(self) -> KeyframePoses:
        """Return the poses of all keyframes as of the last correction."""
        return self._keyframes

    @property
    def num_bent(self) -> int:
        """Return the number of submaps that wait to be fused again."""
        return sum(submap.is_bent for submap in self._voxels.submaps)

    def read(self, slot: int) -> DepthView | None:
        """Return the stored image of a slot, or None if it has been removed.

        Raises:
            OSError: Its file cannot be read.
        """
        view = self._views.get(slot)
        return None if view is None else view.read()

    def add(self, request: SceneRequest, view: DepthView) -> None:
        """Store an image, and fuse it into the dense map.

        It is ignored if its keyframe does not exist any more. If the request has keyframe poses
        that are not older than those of the ledger, they are applied first (`correct`).

        Args:
            request: Time, pose and keyframe of the image.
            view: Its depth and color.

        Raises:
            OSError: The file of the image cannot be written.
        """
        keyframes = self._keyframes if request.keyframes is None else request.keyframes
        rows = np.flatnonzero(keyframes.uids == request.reference_uid)
        if len(rows) == 0:
            return
        T_keyframe_camera = se3.inverse(keyframes.T_map_camera[rows[0]]) @ request.T_map_camera
        if keyframes.version >= self._keyframes.version:
            self.correct(keyframes)
        self.restore(StoredView(view, request.reference_uid, T_keyframe_camera))

    def restore(self, view: StoredView) -> None:
        """Store an image with a pose relative to a keyframe, and fuse it into the dense map.

        It is ignored if its keyframe or its file does not exist. A view without a slot (-1) gets
        the next one. A view with a slot was reported by the ledger of a process that has died: it
        keeps its slot and is not reported again, unless it is ignored: then `take_changes` reports
        it as removed. If many images are stored near this one, the most redundant of them is
        removed.

        Raises:
            OSError: A file for the image cannot be written.
        """
        if view.slot >= 0:
            self._reported[view.slot] = view
        else:
            view = replace(view, slot=self._next_slot)
        self._next_slot = max(self._next_slot, view.slot + 1)
        rows = np.flatnonzero(self._keyframes.uids == view.keyframe_uid)
        if len(rows) == 0:
            return
        try:
            image = view.read()
        except OSError:  # its file was removed when the process died
            return
        if isinstance(view.source, DepthView):
            file = ViewFile.write(self._folder / f'{view.slot}.view', view.source)
            view = replace(view, source=file)
        posed = self._posed(view, image)
        self._voxels.integrate(posed)
        self._camera_m = posed.T_map_camera[:3, 3]
        self._voxels.limit_memory(posed.T_map_camera)
        self._views[view.slot] = view
        self._limit_views(posed)

    def correct(self, keyframes: KeyframePoses, *, force: bool = False) -> bool:
        """Apply corrected keyframe poses: move the submaps, and find those that are bent.

        Args:
            keyframes: The poses of all keyframes.
            force: Whether to check all submaps against a ten times smaller limit, as at the end of
                a run, and to fuse all bent submaps again now. False: they wait for `fuse_bent`.

        Returns:
            Whether there were bent submaps, which have been fused again if `force` is set.

        Raises:
            OSError: With `force`, the file of an image cannot be read.
        """
        before, self._keyframes = self._keyframes, keyframes
        if before is not NO_KEYFRAMES:
            self._reattach(before)
        moved = _moved_uids(before, keyframes)
        self._voxels.move(keyframes, moved)
        if moved or force:
            self._find_bent(moved, force=force)
        is_bent = self.num_bent > 0
        while force and self.fuse_bent(np.inf):  # one map at a time
            pass
        return is_bent

    def fuse_bent(self, region_m: float = _REGION_M) -> bool:
        """Make the voxels of bent submaps in one region again from their stored images.

        A submap is bent if its images have moved relative to it. The region is around the bent
        submap that is nearest to the camera, and contains submaps of the same map only.

        Args:
            region_m: Radius of the region [m]. Submaps near each other are made of nearly the
                same images, so that few images are read.

        Returns:
            False if there was no bent submap. After True, bent submaps of other regions may
            remain.

        Raises:
            OSError: The file of an image cannot be read.
        """
        bent = [submap for submap in self._voxels.submaps if submap.is_bent]
        if not bent:
            return False
        centers_m = np.array([submap.center_map_m for submap in bent])
        first = np.argmin(np.linalg.norm(centers_m - self._camera_m, axis=1))
        near = np.linalg.norm(centers_m - centers_m[first], axis=1) < region_m
        region = [
            submap
            for submap, is_near in zip(bent, near, strict=True)
            if is_near and submap.map_id == bent[first].map_id
        ]
        slots = sorted(set().union(*(submap.fused for submap in region)))
        for submap in region:
            submap.clear()
        changing = set(region)
        for slot in slots:
            view = self._views[slot]
            posed = self._posed(view, view.read())
            changing.update(self._voxels.integrate(posed, changing))
            self._voxels.limit_memory(posed.T_map_camera)
        return True

    def clear(self) -> None:
        """Discard all images and voxels."""
        self._voxels.remove(list(self._voxels.submaps))
        for slot in list(self._views):
            self._discard(slot)

    def take_changes(self) -> Iterator[ViewChange]:
        """Yield the images that were stored, reattached or removed since the last call.

        Reattached images belong to another keyframe. The view of a removed image is None.
        """
        before, self._reported = self._reported, dict(self._views)
        for slot, view in self._reported.items():
            old = before.pop(slot, None)
            if old is None or old.T_keyframe_camera is not view.T_keyframe_camera:
                yield ViewChange(slot, view)
        for slot in before:
            yield ViewChange(slot, None)

    def _discard(self, slot: int) -> None:
        view = self._views.pop(slot)
        for submap in self._voxels.submaps:
            submap.forget(slot)
        if isinstance(view.source, ViewFile):
            with suppress(OSError):
                view.source.path.unlink()

    def _posed(self, view: StoredView, image: DepthView) -> PosedView:
        row = int(self._keyframes.rows_of(np.array([view.keyframe_uid]))[0])
        T_map_keyframe = self._keyframes.T_map_camera[row]
        T_map_camera = T_map_keyframe @ view.T_keyframe_camera
        map_id = int(self._keyframes.map_ids[row])
        return PosedView(image, view.slot, T_map_camera, view.keyframe_uid, map_id, T_map_keyframe)

    def _poses(self, slots: list[int]) -> FloatArray:
        """Return the (N, 4, 4) poses of stored images, each in the frame of its own map."""
        if not slots:
            return np.empty((0, 4, 4))
        T = np.array([self._views[slot].T_keyframe_camera for slot in slots])
        return np.asarray(self._keyframes.T_map_camera[self._rows(slots)] @ T)

    def _rows(self, slots: list[int]) -> IntArray:
        """Return the rows of the keyframes of stored images."""
        uids = np.array([self._views[slot].keyframe_uid for slot in slots], np.int64)
        return self._keyframes.rows_of(uids)

    def _find_bent(self, moved: set[int], *, force: bool) -> None:
        """Update which submaps are bent.

        Only submaps are checked whose anchor has moved, or into which images of moved keyframes
        were fused. A submap is bent if its images have moved relative to it by more than half a
        voxel, and if enough of them are still stored.

        Args:
            moved: Uids of the moved keyframes.
            force: Check all submaps with stored images, and with a ten times smaller limit.
        """
        slots = [s for s, v in self._views.items() if force or v.keyframe_uid in moved]
        touched = set(slots)
        voxels = _FORCED_VOXELS if force else _BENT_VOXELS
        poses = dict(zip(self._views, self._poses(list(self._views)), strict=True))
        for submap in self._voxels.submaps:
            if submap.fused.isdisjoint(touched) and submap.anchor_uid not in moved:
                continue
            is_bent = submap.bend_m(poses) > voxels * self._config.voxel_m
            needed = min(_ENOUGH, _MIN_SHARE * submap.num_fused)
            submap.is_bent = is_bent and len(submap.fused) >= needed

    def _limit_views(self, posed: PosedView) -> None:
        """Remove the most redundant stored image near a new one if too many are stored there."""
        slots = list(self._views)
        T = self._poses(slots)
        near = np.linalg.norm(T[:, :3, 3] - posed.T_map_camera[:3, 3], axis=1) < _NEAR_M
        near &= self._keyframes.map_ids[self._rows(slots)] == posed.map_id
        rows = np.flatnonzero(near)
        if len(rows) > _MAX_NEAR:
            self._discard(slots[rows[_most_redundant(T[rows])]])

    def _reattach(self, before: KeyframePoses) -> None:
        """Attach images and submaps of removed keyframes to other keyframes of the same map.

        If none of its keyframes remains, they are discarded.

        Args:
            before: The keyframe poses before the correction.
        """
        remaining = set(self._keyframes.uids.tolist())
        removed = set(before.uids.tolist()) - remaining
        if not removed:
            return
        substitutes = {uid: before.substitute(uid, self._keyframes) for uid in removed}
        for slot, view in list(self._views.items()):
            if view.keyframe_uid in removed:
                near = substitutes[view.keyframe_uid]
                if near is None:
                    self._discard(slot)
                    continue
                uid, T_near_old = near
                T = T_near_old @ view.T_keyframe_camera
                self._views[slot] = replace(view, keyframe_uid=uid, T_keyframe_camera=T)
        gone = []
        for submap in self._voxels.submaps:
            if submap.anchor_uid in removed:
                near = substitutes[submap.anchor_uid]
                if near is None:
                    gone.append(submap)
                    continue
                submap.anchor_uid = near[0]
                submap.T_anchor_submap = near[1] @ submap.T_anchor_submap
        self._voxels.remove(gone)


def _moved_uids(before: KeyframePoses, after: KeyframePoses) -> set[int]:
    """Return the uids of the keyframes whose poses or maps have changed."""
    uids, old, new = np.intersect1d(before.uids, after.uids, True, return_indices=True)
    change = np.abs(before.T_map_camera[old] - after.T_map_camera[new]).max(axis=(1, 2), initial=0)
    has_moved = (change > 0) | (before.map_ids[old] != after.map_ids[new])
    return set(uids[has_moved].tolist())


def _most_redundant(T: FloatArray) -> int:
    """Return the row of the older one of the two most similar poses (N, 4, 4), oldest first.

    The difference of two poses is their distance [m] plus 2 m per rad between their view axes.
    """
    gap = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=2)
    cosine = np.clip(np.einsum('ik,jk->ij', T[:, :3, 2], T[:, :3, 2]), -1, 1)
    gap += _ROTATION_M_PER_RAD * np.arccos(cosine)
    gap[np.tril_indices(len(gap))] = np.inf
    return int(np.unravel_index(np.argmin(gap), gap.shape)[0])
