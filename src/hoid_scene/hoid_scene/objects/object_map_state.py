"""The object map in a map file: its objects, each relative to its anchor keyframe."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.io.records import Array, Record, column
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    ObjectState,
)
from hoid_scene.objects.mapped_object import MappedObject
from hoid_scene.objects.place import Place
from hoid_scene.objects.voxel_set import VoxelSet

CLASS_BYTES = 64  # chosen: the longest name of COCO has 14
# Columns with the same name in `MappedObject`.
_COPIED = (
    'object_id', 'num_sightings', 'num_visible', 'num_through', 'first_ns', 'last_ns', 'left_ns',
    'probability', 'evidence', 'direction_m', 'distance_m', 'holder_id', 'moved_ns',
)  # fmt: skip
_OF_VOXELS = ('means_m', 'readings', 'hits', 'misses')
_CLASSES, _VOXELS = ('class_name', 'class_score'), ('key', *_OF_VOXELS)


@dataclass(frozen=True, eq=False)
class ObjectMapState(Record):
    """The object map in a file: O objects, C sums of scores and V voxels, both sorted by object.

    Columns without a comment are those of `MappedObject` and `VoxelSet`.
    """

    object_id: Annotated[IntArray, column('i8', 'objects')]
    anchor: Annotated[NDArray[np.int32], column('i4', 'objects')]  # row of the saved keyframe
    T_anchor_object: Annotated[FloatArray, column('f8', 'objects', 4, 4)]  # anchor: its keyframe
    state: Annotated[NDArray[np.uint8], column('u1', 'objects')]  # value of a `ObjectState`
    num_sightings: Annotated[IntArray, column('i8', 'objects')]
    num_visible: Annotated[IntArray, column('i8', 'objects')]
    num_through: Annotated[IntArray, column('i8', 'objects')]
    first_ns: Annotated[IntArray, column('i8', 'objects')]
    last_ns: Annotated[IntArray, column('i8', 'objects')]
    left_ns: Annotated[IntArray, column('i8', 'objects')]
    probability: Annotated[FloatArray, column('f8', 'objects')]
    evidence: Annotated[FloatArray, column('f8', 'objects')]
    direction_m: Annotated[FloatArray, column('f8', 'objects', 3)]
    distance_m: Annotated[FloatArray, column('f8', 'objects')]
    holder_id: Annotated[IntArray, column('i8', 'objects')]
    was_moved: Annotated[BoolArray, column('?', 'objects')]  # False: `moved_from_m` means None
    moved_from_m: Annotated[FloatArray, column('f8', 'objects', 3)]  # object frame
    moved_ns: Annotated[IntArray, column('i8', 'objects')]
    num_classes: Annotated[NDArray[np.int32], column('i4', 'objects')]  # how many of the C
    num_voxels: Annotated[NDArray[np.int32], column('i4', 'objects')]  # how many of the V
    class_name: Annotated[ByteArray, column('u1', 'classes', CLASS_BYTES)]  # UTF-8, then zeros
    class_score: Annotated[FloatArray, column('f8', 'classes')]
    key: Annotated[NDArray[np.int32], column('i4', 'voxels')]
    means_m: Annotated[Float32Array, column('f4', 'voxels', 3)]
    readings: Annotated[Float32Array, column('f4', 'voxels')]
    hits: Annotated[Float32Array, column('f4', 'voxels')]
    misses: Annotated[Float32Array, column('f4', 'voxels')]
    apart: Annotated[IntArray, column('i8', 'pairs', 2)]  # ids of two objects in one image
    next_id: Annotated[IntArray, column('i8', 1)]  # number of the next new object

    def __len__(self) -> int:
        return len(self.object_id)

    @classmethod
    def of_objects(
        cls,
        objects: Sequence[MappedObject],
        keyframe_uids: IntArray,
        *,
        apart: Iterable[tuple[int, int]] = (),
        next_id: int = 1,
    ) -> ObjectMapState:
        """Return the record of the objects whose anchors are saved.

        Args:
            objects: The objects.
            keyframe_uids: (K,) ascending uids of the saved keyframes.
            apart: Pairs of ids that one image showed as two objects.
            next_id: Number of the next new object.
        """
        saved = set(keyframe_uids.tolist())
        kept = [item for item in objects if item.place.uid in saved]
        classes = [pair for item in kept for pair in item.scores.items()]
        moved_from = [item.moved_from_m for item in kept]
        uids = np.array([item.place.uid for item in kept], np.int64)
        columns: dict[str, Any] = {
            name: [getattr(item, name) for item in kept] for name in _COPIED
        }
        for name in _OF_VOXELS:
            empty = getattr(VoxelSet(), name)
            columns[name] = np.concatenate([empty, *(getattr(i.voxels, name) for i in kept)])
        columns |= {
            'anchor': np.searchsorted(keyframe_uids, uids),
            'T_anchor_object': [item.place.T_anchor_object for item in kept],
            'state': [item.state.value for item in kept],
            'was_moved': [place is not None for place in moved_from],
            'moved_from_m': [np.zeros(3) if place is None else place for place in moved_from],
            'num_classes': [len(item.scores) for item in kept],
            'num_voxels': [len(item.voxels) for item in kept],
            'class_name': [_encoded(name) for name, _ in classes],
            'class_score': [score for _, score in classes],
            'key': np.concatenate([np.empty(0, np.int64), *(item.voxels.keys for item in kept)]),
            'apart': sorted(apart),
            'next_id': [next_id],
        }
        return cls._of_lists(columns)

    @classmethod
    def _of_lists(cls, columns: dict[str, Any]) -> ObjectMapState:
        """Return the record of columns, given by name as lists that may be empty, or as arrays."""
        shapes = {
            name: (-1, *(axis for axis in column.axes[1:] if isinstance(axis, int)))
            for name, column in cls.columns().items()
        }
        return cls.of({name: np.array(columns[name]).reshape(shapes[name]) for name in shapes})

    def with_anchors(self, anchor: IntArray) -> ObjectMapState:
        """Return the objects with other anchors (O,); those with the anchor -1 are left out."""
        kept = anchor >= 0
        of_class, of_voxel = (
            np.repeat(kept, count) for count in (self.num_classes, self.num_voxels)
        )
        out: dict[str, Array] = {'anchor': anchor[kept], 'next_id': self.next_id}
        for name, array in self.arrays().items():
            if name in _CLASSES:
                out[name] = array[of_class]
            elif name in _VOXELS:
                out[name] = array[of_voxel]
            elif name not in out:
                out[name] = array if name == 'apart' else array[kept]
        return self.of(out)

    def objects(self, keyframes: KeyframePoses, keyframe_uids: IntArray) -> list[MappedObject]:
        """Return the saved objects, placed by the present poses of their anchor keyframes.

        An object whose anchor keyframe has been removed since the map was loaded is left out.

        Args:
            keyframes: The present poses of all keyframes.
            keyframe_uids: (K,) present uids of the keyframes, in the order of the saved map.
        """
        classes = np.split(np.arange(len(self.class_score)), np.cumsum(self.num_classes)[:-1])
        voxels = np.split(np.arange(len(self.key)), np.cumsum(self.num_voxels)[:-1])
        out = []
        for o in range(len(self)):  # some tens
            uid = int(keyframe_uids[self.anchor[o]])
            at = keyframes.row_of(uid)
            if at is not None:
                T = self.T_anchor_object[o]
                place = Place(keyframes.T_map_camera[at] @ T, T, uid, int(keyframes.map_ids[at]))
                out.append(self._object(_Rows(o, classes[o], voxels[o]), place))
        return out

    def _object(self, rows: _Rows, place: Place) -> MappedObject:
        o = rows.row
        item = MappedObject(int(self.object_id[o]), place, int(self.first_ns[o]))
        for name in _COPIED:
            value = getattr(self, name)[o]
            setattr(item, name, value.copy() if value.ndim else value.item())
        item.state, item.is_cut = ObjectState(int(self.state[o])), False
        item.moved_from_m = self.moved_from_m[o].copy() if self.was_moved[o] else None
        item.scores = {
            decoded(self.class_name[c]): float(self.class_score[c]) for c in rows.classes
        }
        item.voxels.keys = self.key[rows.voxels].astype(np.int64)
        item.voxels.means_m = self.means_m[rows.voxels].astype(np.float64)
        for name in _OF_VOXELS[1:]:
            setattr(item.voxels, name, getattr(self, name)[rows.voxels].copy())
        return item


class _Rows(NamedTuple):
    """The rows of one object in a record."""

    row: int  # among the O objects
    classes: IntArray  # rows among the C sums of scores
    voxels: IntArray  # rows among the V voxels


def _encoded(name: str) -> ByteArray:
    """Return a class name as CLASS_BYTES bytes of UTF-8, filled up with zeros.

    A longer name is cut off between two characters.
    """
    text = name.encode()[:CLASS_BYTES].decode(errors='ignore').encode()
    return np.frombuffer(text.ljust(CLASS_BYTES, b'\0'), np.uint8)


def decoded(name: ByteArray) -> str:
    """Return the class name in CLASS_BYTES bytes; raise UnicodeDecodeError if it is not UTF-8."""
    return name.tobytes().rstrip(b'\0').decode()
