"""The object map in a map file: its objects, each relative to its anchor keyframe."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

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
from hoid_scene.objects.voxel_set import VoxelSet
from hoid_scene.place import Place

CLASS_BYTES = 64  # chosen: the longest name of COCO has 14
# Columns named like attributes of a `MappedObject` and of its parts.
_OF_OBJECT = ('object_id', 'left_ns', 'holder_id', 'moved_ns')
_OF_EVIDENCE = (
    'num_sightings', 'num_visible', 'num_through', 'first_ns', 'last_ns', 'probability', 'weight',
)  # fmt: skip
_OF_SURFACE = ('num_looks', 'direction_m', 'distance_m')
_OF_VOXELS = ('means_m', 'readings', 'hits', 'misses')
# Columns with several rows for an object, by the column that counts these rows.
_PARTS = {
    'num_classes': ('class_name', 'class_score'),
    'num_views': ('view', 'view_count'),
    'num_voxels': ('key', *_OF_VOXELS),
}


@dataclass(frozen=True, eq=False)
class ObjectMapState(Record):
    """The object map in a file: O objects, with classes, views and voxels sorted by object.

    Columns without a comment are those of `MappedObject`, its parts and `VoxelSet`.
    """

    object_id: Annotated[IntArray, column('i8', 'objects')]
    anchor: Annotated[NDArray[np.int32], column('i4', 'objects')]  # row of the saved keyframe
    T_anchor_object: Annotated[FloatArray, column('f8', 'objects', 4, 4)]  # anchor: its keyframe
    left_as: Annotated[NDArray[np.uint8], column('u1', 'objects')]  # AT_REST: it is at its place
    num_sightings: Annotated[IntArray, column('i8', 'objects')]
    num_visible: Annotated[IntArray, column('i8', 'objects')]
    num_through: Annotated[IntArray, column('i8', 'objects')]
    num_looks: Annotated[IntArray, column('i8', 'objects')]
    first_ns: Annotated[IntArray, column('i8', 'objects')]
    last_ns: Annotated[IntArray, column('i8', 'objects')]
    left_ns: Annotated[IntArray, column('i8', 'objects')]
    probability: Annotated[FloatArray, column('f8', 'objects')]
    weight: Annotated[FloatArray, column('f8', 'objects')]
    direction_m: Annotated[FloatArray, column('f8', 'objects', 3)]
    distance_m: Annotated[FloatArray, column('f8', 'objects')]
    holder_id: Annotated[IntArray, column('i8', 'objects')]
    was_moved: Annotated[BoolArray, column('?', 'objects')]  # False: `moved_from_m` means None
    moved_from_m: Annotated[FloatArray, column('f8', 'objects', 3)]  # object frame
    moved_ns: Annotated[IntArray, column('i8', 'objects')]
    num_classes: Annotated[NDArray[np.int32], column('i4', 'objects')]
    num_views: Annotated[NDArray[np.int32], column('i4', 'objects')]
    num_voxels: Annotated[NDArray[np.int32], column('i4', 'objects')]
    class_name: Annotated[ByteArray, column('u1', 'classes', CLASS_BYTES)]  # UTF-8, then zeros
    class_score: Annotated[FloatArray, column('f8', 'classes')]
    view: Annotated[FloatArray, column('f8', 'views', 3)]  # unit vector, object frame
    view_count: Annotated[IntArray, column('i8', 'views')]
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
        """Return the record of those objects whose anchor keyframe is in `keyframe_uids`."""
        saved = set(keyframe_uids.tolist())
        kept = [item for item in objects if item.surface.place.uid in saved]
        surfaces, evidence = [item.surface for item in kept], [item.evidence for item in kept]
        classes = [pair for seen in evidence for pair in seen.scores.items()]
        voxels = [VoxelSet(), *(surface.voxels for surface in surfaces)]
        uids = np.array([surface.place.uid for surface in surfaces], np.int64)
        columns: dict[str, Any] = {
            name: [getattr(part, name) for part in parts]
            for names, parts in (
                (_OF_OBJECT, kept), (_OF_EVIDENCE, evidence), (_OF_SURFACE, surfaces),
            )
            for name in names
        }  # fmt: skip
        columns |= {
            name: np.concatenate([getattr(v, name) for v in voxels]) for name in _OF_VOXELS
        }
        columns |= {
            'anchor': np.searchsorted(keyframe_uids, uids),
            'T_anchor_object': [surface.place.T_anchor_place for surface in surfaces],
            'left_as': [(item.left_as or ObjectState.AT_REST).value for item in kept],
            'was_moved': [item.moved_from_m is not None for item in kept],
            'moved_from_m': [
                np.zeros(3) if item.moved_from_m is None else item.moved_from_m for item in kept
            ],
            'num_classes': [len(seen.scores) for seen in evidence],
            'num_views': [len(seen.views) for seen in evidence],
            'num_voxels': [len(surface.voxels) for surface in surfaces],
            'class_name': [_encoded(name) for name, _ in classes],
            'class_score': [score for _, score in classes],
            'view': [direction for seen in evidence for direction in seen.views.directions],
            'view_count': [count for seen in evidence for count in seen.views.counts],
            'key': np.concatenate([each.keys for each in voxels]),
            'apart': sorted(apart),
            'next_id': [next_id],
        }
        shapes = {
            name: (-1, *(axis for axis in column.axes[1:] if isinstance(axis, int)))
            for name, column in cls.columns().items()
        }
        return cls.of({name: np.array(columns[name]).reshape(shapes[name]) for name in shapes})

    def with_anchors(self, anchor: IntArray) -> ObjectMapState:
        """Return the objects with new anchors (O,); objects with the anchor -1 are left out."""
        kept, out = anchor >= 0, self.arrays()
        of_parts = {name: count for count, names in _PARTS.items() for name in names}
        for name, array in self.arrays().items():
            if name in of_parts:
                out[name] = array[np.repeat(kept, getattr(self, of_parts[name]))]
            elif name not in ('apart', 'next_id'):
                out[name] = array[kept]
        return self.of({**out, 'anchor': anchor[kept]})

    def objects(self, keyframes: KeyframePoses, keyframe_uids: IntArray) -> list[MappedObject]:
        """Return the saved objects, placed by the present poses of their anchor keyframes."""
        parts = {
            name: np.split(getattr(self, name), np.cumsum(getattr(self, count))[:-1])
            for count, names in _PARTS.items()
            for name in names
        }
        out = []
        for o in range(len(self)):  # fast enough for some tens
            uid = int(keyframe_uids[self.anchor[o]])
            place = Place.saved(self.T_anchor_object[o], uid, keyframes)
            if place is not None:
                own = {name: arrays[o] for name, arrays in parts.items()}
                out.append(self._object(o, own, place))
        return out

    def _object(self, o: int, own: dict[str, Array], place: Place) -> MappedObject:
        item = MappedObject(int(self.object_id[o]), place, int(self.first_ns[o]))
        surface, evidence = item.surface, item.evidence
        for names, part in ((_OF_OBJECT, item), (_OF_EVIDENCE, evidence), (_OF_SURFACE, surface)):
            for name in names:
                value = getattr(self, name)[o]
                setattr(part, name, value.copy() if value.ndim else value.item())
        left_as, surface.is_cut = ObjectState(int(self.left_as[o])), False
        item.left_as = None if left_as is ObjectState.AT_REST else left_as
        item.moved_from_m = self.moved_from_m[o].copy() if self.was_moved[o] else None
        classes = map(decoded, own['class_name'])
        evidence.scores = dict(zip(classes, own['class_score'].tolist(), strict=True))
        evidence.views.directions = own['view'].copy()
        evidence.views.counts = own['view_count'].tolist()
        surface.voxels.keys = own['key'].astype(np.int64)
        surface.voxels.means_m = own['means_m'].astype(np.float64)
        for name in _OF_VOXELS[1:]:
            setattr(surface.voxels, name, own[name].copy())
        return item


def _encoded(name: str) -> ByteArray:
    """Return a class name as CLASS_BYTES bytes of UTF-8, filled up with zeros.

    A longer name is cut off between two characters.
    """
    text = name.encode()[:CLASS_BYTES].decode(errors='ignore').encode()
    return np.frombuffer(text.ljust(CLASS_BYTES, b'\0'), np.uint8)


def decoded(name: ByteArray) -> str:
    """Return the class name in CLASS_BYTES bytes; raise UnicodeDecodeError if it is not UTF-8."""
    return name.tobytes().rstrip(b'\0').decode()
