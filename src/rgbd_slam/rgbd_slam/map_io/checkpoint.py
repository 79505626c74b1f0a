"""Writes checkpoints: new and changed rows of a map to segments, and an index (decision 042)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.values import FloatArray, IntArray
from hoid_scene.dense.submap_export import ExportMark, SubmapExport
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.map_io import archive
from rgbd_slam.map_io.checkpoint_folder import CheckpointFolder, set_stamp
from rgbd_slam.map_io.checkpoint_index import (
    INDEX,
    SEGMENTS,
    CheckpointIndex,
    CubeRows,
    IndexedKeyframes,
    IndexedSubmaps,
    VoxelRows,
)
from rgbd_slam.map_io.map_parts import KeyframeCopy, MapPart, MapParts
from rgbd_slam.map_io.segments import Segment
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.store.tables import MapHeader

_SPARE_BYTES = 16_000_000  # chosen: dead bytes that are not worth writing a segment again


class CheckpointWriter:
    """Writes the checkpoints of one map, which replace a checkpoint of an earlier map.

    `parts` copies the map between two images. Each of its parts is passed to `append`. If it is
    the last part of a checkpoint, its keyframes are passed to `finish` as well. After an error,
    the rows of the failed part are copied and appended again.

    Args:
        folder: The checkpoint of the node.
        atlas: The map.
    """

    def __init__(self, folder: CheckpointFolder, atlas: Atlas) -> None:
        self.parts = MapParts(atlas)
        self.num_bytes = 0  # written to segments since the last checkpoint was finished
        self._folder = folder
        self._segments = {name: self._new_segment(name) for name in SEGMENTS}
        self._submaps = _StoredSubmaps()
        self._objects = _StoredObjects(None, np.empty(0, np.int64))
        self._has_dense = False  # whether the last checkpoint has a dense map

    @property
    def submaps_since(self) -> ExportMark | None:
        """Return the mark of the export up to which changes of the dense map are stored.

        None is returned if all submaps have to be exported.
        """
        return self._submaps.mark

    @property
    def num_voxels(self) -> int:
        """Return the number of voxels of the stored dense map."""
        return self._submaps.num_voxels

    @property
    def total_bytes(self) -> int:
        """Return the size of all segments in bytes, including rows that are no longer used."""
        return sum(segment.num_bytes for segment in self._segments.values())

    def close(self) -> None:
        """Close the files."""
        for segment in self._segments.values():
            segment.close()

    def append(self, part: MapPart) -> None:
        """Append a part to the segments; readers ignore it until `finish` has written the index.

        Raises:
            MapFileError: It cannot be written.
        """
        with self._described_errors(), self._anew_if_missing():
            self._folder.path.mkdir(parents=True, exist_ok=True)
            before = self.total_bytes
            first_feature = self._segments['features'].append(part.features)
            first_state = self._segments['states'].append(part.states)
            self._segments['points'].append(part.points)
            self.parts.note(part, first_feature, first_state)
            self.num_bytes += self.total_bytes - before

    def finish(
        self,
        header: MapHeader,
        keyframes: KeyframeCopy,
        submaps: SubmapExport | None,
        stamp_ns: int,
        *,
        objects: ObjectMapState | None = None,
        keep_submaps: bool = False,
    ) -> int:
        """Replace the checkpoint by the map whose parts were appended; delete unused files.

        Args:
            header: Camera, octaves and frame of the map.
            keyframes: The keyframes, from the last part.
            submaps: The changes of the dense map since `submaps_since`; None: there is no dense
                map.
            stamp_ns: Stamp of the last image that was tracked in the map.
            objects: The object map, whose anchors are rows of these keyframes; None: there is
                none.
            keep_submaps: Keep the dense map and the object map of the last checkpoint, and ignore
                `submaps` and `objects`, because the present ones could not be obtained.

        Returns:
            Number of bytes written to segments and index since the last checkpoint.

        Raises:
            MapFileError: The checkpoint cannot be written, or the dense map is to be kept but its
                segments are to be written anew; the old checkpoint is unchanged.
        """
        columns = self.parts.located(keyframes)
        if keep_submaps and self._has_dense and not len(self._submaps):
            raise MapFileError(
                'the dense map has to be written anew and has not arrived; the last checkpoint is '
                'kept'
            )
        index = self._folder.path / INDEX
        with self._described_errors():
            before = self.total_bytes
            if not keep_submaps:
                self._objects = _StoredObjects(objects, columns['uid'])
                with self._anew_if_missing():
                    self._submaps.append(submaps, self._segments)
            self.num_bytes += self.total_bytes - before
            self._sync()
            with archive.replaced(index) as file:
                kept = self._submaps.record(columns['uid'])
                kept_objects = self._objects.record(columns['uid'])
                rows = IndexedKeyframes.of(columns)
                content = CheckpointIndex(header, rows, kept, kept_objects)
                content.write(file, self._segments)
                written, self.num_bytes = self.num_bytes + file.tell(), 0
                # The index gets its stamp before it replaces the old index, so that a process that
                # is killed at any time leaves an index with its stamp.
                file.flush()  # a later write would stamp the file with the time of day
                set_stamp(file.fileno(), stamp_ns)
        self._has_dense = len(kept.arrays()['anchor_uid']) > 0
        self._remove_unused()
        self._compact(keyframes)
        return written

    def _new_segment(self, name: str) -> Segment:
        return Segment(self._folder.path, name, SEGMENTS[name])

    def _sync(self) -> None:
        try:
            for segment in self._segments.values():
                segment.sync()
        except OSError:
            # After this error, Linux no longer knows which bytes are missing on the disk, so that
            # everything has to be written to new segments.
            self._replace_all()
            raise

    @contextmanager
    def _anew_if_missing(self) -> Iterator[None]:
        """Replace all segments by empty ones if somebody has deleted one; raise the error again.

        The next checkpoint then writes everything.
        """
        try:
            yield
        except FileNotFoundError:
            self._replace_all()
            raise

    def _compact(self, keyframes: KeyframeCopy) -> None:
        """Replace segments of mostly unused rows by empty ones, which are filled next time."""
        num_features = int(keyframes.columns['num_features'].sum())
        alive = {'features': num_features, 'states': num_features, 'points': keyframes.num_points}
        alive['voxels'], alive['cubes'] = self._submaps.num_voxels, len(self._submaps)
        for name, segment in self._segments.items():
            if segment.is_wasteful(alive[name], _SPARE_BYTES):
                self._replace(name)

    def _replace_all(self) -> None:
        for name in SEGMENTS:
            self._replace(name)

    def _replace(self, name: str) -> None:
        self._segments[name].close()
        self._segments[name] = self._new_segment(name)
        match name:
            case 'features':
                self.parts.forget_features()
            case 'states':
                self.parts.forget_states()
            case 'points':
                self.parts.forget_points()
            case _:  # all submaps are stored again
                self._submaps = _StoredSubmaps()

    def _remove_unused(self) -> None:
        """Remove all files of the folder but the index and the segments that it refers to."""
        used = {INDEX, *(segment.path.name for segment in self._segments.values())}
        with suppress(OSError):
            for path in self._folder.path.iterdir():
                if path.name not in used:
                    path.unlink()

    @contextmanager
    def _described_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise MapFileError(
                f'{self._folder.path}: cannot be written: {error.strerror}'
            ) from error


class _StoredObjects(NamedTuple):
    """The object map that was passed last; None: there was none."""

    state: ObjectMapState | None
    keyframe_uids: IntArray  # (K,) uids of the keyframes whose rows are the anchors of `state`

    def record(self, keyframe_uids: IntArray) -> ObjectMapState | None:
        """Return the objects whose anchors are among the keyframes with these ascending uids (M,).

        None is returned if there is no object map.
        """
        if self.state is None:
            return None
        rows = np.searchsorted(keyframe_uids, self.keyframe_uids)
        is_saved = np.isin(self.keyframe_uids, keyframe_uids)
        return self.state.reanchored(np.where(is_saved, rows, -1))


class _StoredSubmap(NamedTuple):
    anchor_uid: int
    T_anchor_submap: FloatArray  # (4, 4)
    first_voxel: int
    num_voxels: int
    cube: int


class _StoredSubmaps:
    """The rows at which the submaps of the dense map are stored in the segments."""

    def __init__(self) -> None:
        self.mark: ExportMark | None = None
        self._voxel_m = 1.0
        self._stored: dict[int, _StoredSubmap] = {}  # by the number of the submap

    def __len__(self) -> int:
        return len(self._stored)

    @property
    def num_voxels(self) -> int:
        """Return the number of voxels of all submaps."""
        return sum(submap.num_voxels for submap in self._stored.values())

    def append(self, export: SubmapExport | None, segments: dict[str, Segment]) -> None:
        """Append the changed submaps to the segments, and forget those that no longer exist.

        Args:
            export: The changes since the last call; None: there is no dense map.
            segments: The segments by name, of which `voxels` and `cubes` are extended.
        """
        if export is None:
            self.mark, self._stored = None, {}
            return
        state = export.changed
        voxel = segments['voxels'].append(
            VoxelRows(state.key, state.offset, state.color_bgr, state.weight, state.counts)
        )
        cube = segments['cubes'].append(CubeRows(state.free_above))
        counts = state.num_voxels.astype(np.int64)
        firsts = (voxel + np.cumsum(counts) - counts).tolist()
        rows = {number: row for row, number in enumerate(export.changed_numbers.tolist())}
        stored = {}
        for number, uid, T in zip(
            export.numbers.tolist(),
            export.anchor_uids.tolist(),
            export.T_anchor_submap,
            strict=True,
        ):
            row = rows.get(number)
            if row is not None:
                stored[number] = _StoredSubmap(uid, T, firsts[row], int(counts[row]), cube + row)
            elif number in self._stored:
                stored[number] = self._stored[number]._replace(anchor_uid=uid, T_anchor_submap=T)
        self.mark, self._stored, self._voxel_m = export.mark, stored, float(state.voxel_m[0])

    def record(self, keyframe_uids: IntArray) -> IndexedSubmaps:
        """Return the index of the submaps whose anchors are among the keyframes (M,)."""
        saved = set(keyframe_uids.tolist())
        kept = [submap for submap in self._stored.values() if submap.anchor_uid in saved]
        return IndexedSubmaps.of(
            {
                'voxel_m': np.array([self._voxel_m]),
                'anchor_uid': np.array([s.anchor_uid for s in kept], np.int64),
                'T_anchor_submap': np.array([s.T_anchor_submap for s in kept]).reshape(-1, 4, 4),
                'num_voxels': np.array([s.num_voxels for s in kept], np.int64),
                'first_voxel': np.array([s.first_voxel for s in kept], np.int64),
                'cube': np.array([s.cube for s in kept], np.int64),
            }
        )
