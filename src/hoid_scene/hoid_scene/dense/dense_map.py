"""The dense map: colored voxels in submaps, and the stored images that were fused into them.

Each submap is anchored to a keyframe, and each image is stored relative to one. A correction of
the keyframes first moves each submap rigidly with its anchor. A submap whose images have moved
relative to it is bent: if enough of them are still stored, they are fused again. The voxels of
loaded submaps have no images: they only move with their anchor keyframe, and new images carve
those that are wrong.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from hoid_common.poses.keyframe_poses import NO_KEYFRAMES, KeyframePoses
from hoid_common.values import CameraModel, FloatArray, IntArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.depth_view import DepthView
from hoid_scene.dense.fusion import Fusion, PosedView
from hoid_scene.dense.submap import ColoredCloud, Submap, move_to_disk, num_in_memory
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.dense.view_store import StoredView, ViewStore
from hoid_scene.place import anchor_at
from hoid_scene.scene_scheduler import SceneRequest

# Chosen: distance [m] by which a rotation is converted to a translation, a typical depth in a
# room.
_ROTATION_M_PER_RAD = 2.0
_BENT_VOXELS = 0.5  # a submap is bent if its images have moved by more voxels; not tuned
_FORCED_VOXELS = 0.05  # the same for a forced correction, as at the end of a run
# Not tuned: largest number of stored images within this distance of a new image; if there are
# more, the most redundant image is removed. A camera that drives past stores 6 images per meter; a
# voxel needs 3.
_NEAR_M, _MAX_NEAR = 2.0, 100
# Not tuned: a submap is rebuilt only if this share of its images, or this number, is still stored.
_MIN_SHARE, _ENOUGH = 0.5, 10
_REGION_M = 3.0  # radius of a region; chosen: bounds the time to fuse it again to about 2 s

# Chosen: submaps move to disk until this share of the largest number of voxels is in memory, so
# that one file takes many of them.
_KEPT_SHARE = 0.75


class DenseMap:
    """Keeps the submaps and the stored images of all maps, and moves them with the keyframes.

    An image changes the submaps of its map that it observes. Surface outside of them starts new
    submaps. Submaps of maps other than the main map are fused in frames of their own and are not
    shown. When a recognized place merges the maps, they move to the map frame. The number of
    images grows with the space that was seen, and not with time.

    Methods raise MapFileError if the store of images cannot be read or written, and OSError if the
    temporary file of voxels cannot.

    Args:
        store: Store of the images, which is empty; None: a temporary one.
    """

    def __init__(
        self, camera: CameraModel, config: DenseConfig, store: ViewStore | None = None
    ) -> None:
        self._config, self._fusion = config, Fusion(camera, config)
        self.camera = self._fusion.camera
        self._store = ViewStore.temporary() if store is None else store
        self.keyframes = NO_KEYFRAMES
        self.submaps: list[Submap] = []  # in the order in which they were created
        self._views: dict[int, StoredView] = {}  # by slot, in the order of storing
        self._next_slot = 0
        self._camera_m = np.zeros(3)  # position of the camera at the last image, map frame
        self._clouds: dict[Submap, tuple[int, ColoredCloud]] = {}  # revision and points

    def __len__(self) -> int:
        return sum(map(len, self.submaps))

    @property
    def views(self) -> tuple[StoredView, ...]:
        return tuple(self._views.values())

    @property
    def num_bent(self) -> int:
        return sum(submap.is_bent for submap in self.submaps)

    @property
    def num_in_memory(self) -> int:
        """Return the number of voxels that are in memory; the others are in a file."""
        return num_in_memory(self.submaps)

    def shown(self) -> list[Submap]:
        return [s for s in self.submaps if s.place.map_id == self.keyframes.main_map]

    def read(self, slot: int) -> DepthView | None:
        """Return the stored image of a slot, or None if it has been removed."""
        return self._store.read(slot) if slot in self._views else None

    def add(self, request: SceneRequest, image: DepthView) -> None:
        """Store an image, and fuse it into the submaps.

        It is ignored if its keyframe does not exist any more. Keyframe poses that are not older
        than the present ones are applied first (`correct`). If many images are stored near this
        one, the most redundant of them is removed.
        """
        T_keyframe_camera = request.T_keyframe_camera
        if request.keyframes is None or T_keyframe_camera is None:
            return
        if request.keyframes.version >= self.keyframes.version:
            self.correct(request.keyframes)
        if self.keyframes.row_of(request.reference_uid) is None:
            return
        view, slot = StoredView(request.reference_uid, T_keyframe_camera), self._next_slot
        self._store.put(slot, view, image)
        self._fuse(slot, view, image)

    def restore(self) -> None:
        """Fuse the images that an earlier process has left in the store."""
        for slot, view in list(self._store.views()):
            if self.keyframes.row_of(view.keyframe_uid) is None:
                self._store.discard(slot)
            else:
                self._fuse(slot, view, self._store.read(slot))

    def _fuse(self, slot: int, view: StoredView, image: DepthView) -> None:
        self._views[slot], self._next_slot = view, slot + 1
        posed = self._posed(slot, image)
        self.integrate(posed)
        self._camera_m = posed.anchor.T_map_camera[:3, 3]
        self._limit_memory(self._camera_m)
        self._limit_views(posed)

    def integrate(
        self, posed: PosedView, only: Collection[Submap] | None = None
    ) -> Sequence[Submap]:
        """Fuse an image into the submaps, without storing it; see `Fusion.integrate`."""
        created = self._fusion.integrate(posed, self.submaps, only)
        self.submaps += created
        return created

    def correct(self, keyframes: KeyframePoses, *, force: bool = False) -> bool:
        """Apply corrected keyframe poses: move the submaps, and find bent submaps.

        Args:
            force: Whether to check all submaps against a ten times smaller limit, as at the end of
                a run, and to fuse all bent submaps again now. False: they wait for `fuse_bent`.

        Returns:
            Whether there were bent submaps, which have been fused again if `force` is set.
        """
        before, self.keyframes = self.keyframes, keyframes
        if before is not NO_KEYFRAMES:
            self._reattach(before)
        moved = _moved_uids(before, keyframes)
        self._remove([s for s in self.submaps if not s.follow(before, keyframes)])
        if moved or force:
            self._find_bent(moved, force=force)
        is_bent = self.num_bent > 0
        while force and self.fuse_bent(np.inf):  # one map at a time
            pass
        return is_bent

    def fuse_bent(self, region_m: float = _REGION_M) -> bool:
        """Fuse the stored images of the bent submaps in one region again.

        The region, of radius `region_m`, is around the bent submap that is nearest to the camera.
        Return False if there was no bent submap.
        """
        bent = [submap for submap in self.submaps if submap.is_bent]
        if not bent:
            return False
        centers_m = np.array([submap.center_map_m for submap in bent])
        first = np.argmin(np.linalg.norm(centers_m - self._camera_m, axis=1))
        near = np.linalg.norm(centers_m - centers_m[first], axis=1) < region_m
        region = [
            submap
            for submap, is_near in zip(bent, near, strict=True)
            if is_near and submap.place.map_id == bent[first].place.map_id
        ]
        slots = sorted(set().union(*(submap.fused for submap in region)))
        for submap in region:
            submap.clear()
        changing = set(region)
        for slot in slots:
            posed = self._posed(slot, self._store.read(slot))
            changing.update(self.integrate(posed, changing))
            self._limit_memory(posed.anchor.T_map_camera[:3, 3])
        return True

    def clear(self) -> None:
        self._remove(list(self.submaps))
        for slot in list(self._views):
            self._discard(slot)

    def cloud(self) -> ColoredCloud:
        parts = [self._cloud_of(submap) for submap in self.shown()]
        if not parts:
            return ColoredCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
        points_m, colors_bgr = zip(*parts, strict=True)
        return ColoredCloud(np.concatenate(points_m), np.concatenate(colors_bgr))

    def export(self, keyframe_uids: IntArray) -> SubmapState:
        """Return the submaps, for a file, whose anchor keyframes are among ascending uids (K,)."""
        return SubmapState.of_submaps(self.submaps, keyframe_uids, self._config)

    def load(self, state: SubmapState, keyframe_uids: IntArray) -> None:
        """Add saved submaps. Their voxels are on disk until an image changes them."""
        loaded = [s for s in state.submaps(self.keyframes, keyframe_uids, self._config) if len(s)]
        if loaded:
            move_to_disk(loaded)
        for submap in loaded:
            submap.keep_as_saved()
        self.submaps += loaded

    def _cloud_of(self, submap: Submap) -> ColoredCloud:
        known = self._clouds.get(submap)
        if known is None or known[0] != submap.revision:
            known = submap.revision, submap.cloud()
            self._clouds[submap] = known
        return known[1]

    def _remove(self, removed: Collection[Submap]) -> None:
        self.submaps = [submap for submap in self.submaps if submap not in removed]
        for submap in removed:
            self._clouds.pop(submap, None)

    def _limit_memory(self, camera_m: FloatArray) -> None:
        """Move the submaps farthest from the camera to disk if too many voxels are in memory."""
        if self.num_in_memory <= self._config.max_voxels:
            return
        loaded = [submap for submap in self.submaps if submap.is_in_memory and len(submap)]
        centers_m = np.array([submap.center_map_m for submap in loaded])
        order = np.argsort(np.linalg.norm(centers_m - camera_m, axis=1), kind='stable')
        total = np.cumsum([len(loaded[i]) for i in order])
        far = order[total > _KEPT_SHARE * self._config.max_voxels]
        move_to_disk([loaded[i] for i in far])

    def _discard(self, slot: int) -> None:
        del self._views[slot]
        for submap in self.submaps:
            submap.forget(slot)
        self._store.discard(slot)

    def _posed(self, slot: int, image: DepthView) -> PosedView:
        anchor = anchor_at(self.keyframes, *self._views[slot])
        assert anchor is not None
        return PosedView(image, slot, anchor)

    def _poses(self, slots: list[int]) -> FloatArray:
        """Return the (N, 4, 4) poses of stored images, each in the frame of its own map."""
        if not slots:
            return np.empty((0, 4, 4))
        T = np.array([self._views[slot].T_keyframe_camera for slot in slots])
        return np.asarray(self.keyframes.T_map_camera[self._rows(slots)] @ T)

    def _rows(self, slots: list[int]) -> IntArray:
        uids = np.array([self._views[slot].keyframe_uid for slot in slots], np.int64)
        return self.keyframes.rows_of(uids)

    def _find_bent(self, moved: set[int], *, force: bool) -> None:
        """Update which submaps are bent.

        A submap is checked only if its anchor has moved, or if images of moved keyframes were
        fused into it. A submap is bent if its images have moved relative to it by more than half a
        voxel, and if enough of them are still stored.
        """
        slots = [s for s, v in self._views.items() if force or v.keyframe_uid in moved]
        touched = set(slots)
        voxels = _FORCED_VOXELS if force else _BENT_VOXELS
        poses = dict(zip(self._views, self._poses(list(self._views)), strict=True))
        for submap in self.submaps:
            if submap.fused.isdisjoint(touched) and submap.place.uid not in moved:
                continue
            is_bent = submap.bend_m(poses) > voxels * self._config.voxel_m
            needed = min(_ENOUGH, _MIN_SHARE * submap.num_fused)
            submap.is_bent = is_bent and len(submap.fused) >= needed

    def _limit_views(self, posed: PosedView) -> None:
        """Remove the most redundant stored image near a new one if too many are stored there."""
        slots = list(self._views)
        T = self._poses(slots)
        near = np.linalg.norm(T[:, :3, 3] - posed.anchor.T_map_camera[:3, 3], axis=1) < _NEAR_M
        near &= self.keyframes.map_ids[self._rows(slots)] == posed.anchor.map_id
        rows = np.flatnonzero(near)
        if len(rows) > _MAX_NEAR:
            self._discard(slots[rows[_most_redundant(T[rows])]])

    def _reattach(self, before: KeyframePoses) -> None:
        """Attach images of removed keyframes to other keyframes of the same map.

        If no keyframe of their map remains, the images are discarded.
        """
        remaining = set(self.keyframes.uids.tolist())
        removed = set(before.uids.tolist()) - remaining
        if not removed:
            return
        substitutes = {uid: before.substitute(uid, self.keyframes) for uid in removed}
        for slot, view in list(self._views.items()):
            if view.keyframe_uid in removed:
                near = substitutes[view.keyframe_uid]
                if near is None:
                    self._discard(slot)
                    continue
                uid, T_near_old = near
                T = T_near_old @ view.T_keyframe_camera
                self._views[slot] = StoredView(uid, T)
                self._store.attach(slot, self._views[slot])


def _moved_uids(before: KeyframePoses, after: KeyframePoses) -> set[int]:
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
