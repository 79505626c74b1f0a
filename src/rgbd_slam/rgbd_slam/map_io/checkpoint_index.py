"""The index of a checkpoint: which rows of its segments are valid, and data that has no segment.

The index is a small archive that is replaced as a whole, so that a checkpoint is either the last
complete one or the one before, whenever a process or a computer dies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Annotated, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import MapFileError
from hoid_common.io.records import Array, Record, column
from hoid_common.values import ByteArray, CameraModel, Float32Array, FloatArray, IntArray
from hoid_scene.dense.submap import SPAN
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.map_io import archive
from rgbd_slam.map_io.map_parts import FeatureRows, PointRows, StateRows
from rgbd_slam.map_io.segments import Rows, Segment
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_state import NONE, MapState, rows_of_uids
from rgbd_slam.store.map_file import MapFile, check
from rgbd_slam.store.tables import MapHeader

INDEX = 'index'
"""Name of the index in the folder of a checkpoint."""
_FORMAT, _VERSION = 'hoid checkpoint', 1


@dataclass(frozen=True, eq=False)
class VoxelRows(Record):
    """Voxels of submaps, as in `SubmapState`."""

    key: Annotated[NDArray[np.int32], column('i4', 'voxels')]
    offset: Annotated[ByteArray, column('u1', 'voxels', 3)]
    color_bgr: Annotated[ByteArray, column('u1', 'voxels', 3)]
    weight: Annotated[Float32Array, column('f4', 'voxels')]
    counts: Annotated[ByteArray, column('u1', 'voxels', 2)]


@dataclass(frozen=True, eq=False)
class CubeRows(Record):
    """The free space of submaps, as in `SubmapState`."""

    free_above: Annotated[NDArray[np.uint16], column('u2', 'submaps', SPAN // 2, SPAN // 2)]


@dataclass(frozen=True, eq=False)
class IndexedKeyframes(Record):
    """The K keyframes by ascending uid, and the rows of their features in the segments."""

    uid: Annotated[IntArray, column('i8', 'keyframes')]
    stamp_ns: Annotated[IntArray, column('i8', 'keyframes')]
    T_map_camera: Annotated[FloatArray, column('f8', 'keyframes', 4, 4)]  # core's map frame
    map_id: Annotated[IntArray, column('i8', 'keyframes')]
    # In the spanning tree; -1 for the root of a map.
    parent_uid: Annotated[IntArray, column('i8', 'keyframes')]
    num_features: Annotated[IntArray, column('i8', 'keyframes')]
    first_feature: Annotated[IntArray, column('i8', 'keyframes')]  # row in segment `features`
    first_state: Annotated[IntArray, column('i8', 'keyframes')]  # row in segment `states`


@dataclass(frozen=True, eq=False)
class IndexedSubmaps(Record):
    """The S submaps of the dense map, and the rows of their contents in the segments."""

    voxel_m: Annotated[FloatArray, column('f8', 1)]  # side of a voxel
    anchor_uid: Annotated[IntArray, column('i8', 'submaps')]  # uid of the anchor keyframe
    T_anchor_submap: Annotated[FloatArray, column('f8', 'submaps', 4, 4)]
    num_voxels: Annotated[IntArray, column('i8', 'submaps')]
    first_voxel: Annotated[IntArray, column('i8', 'submaps')]  # row in segment `voxels`
    cube: Annotated[IntArray, column('i8', 'submaps')]  # row in segment `cubes`: its free space


@dataclass(frozen=True, eq=False)
class Chunks(Record):
    """For each segment: the number of rows of each of its chunks, in order."""

    features: Annotated[IntArray, column('i8', 'features')]
    states: Annotated[IntArray, column('i8', 'states')]
    points: Annotated[IntArray, column('i8', 'points')]
    voxels: Annotated[IntArray, column('i8', 'voxels')]
    cubes: Annotated[IntArray, column('i8', 'cubes')]


SEGMENTS: dict[str, type[Record]] = {
    'features': FeatureRows,
    'states': StateRows,
    'points': PointRows,
    'voxels': VoxelRows,
    'cubes': CubeRows,
}
_SECTIONS: dict[str, type[Record]] = {
    'keyframes': IndexedKeyframes,
    'submaps': IndexedSubmaps,
    'chunks': Chunks,
    'objects': ObjectMapState,  # only if there are objects
}


class CheckpointIndex(NamedTuple):
    """The parts of a map that the index of its checkpoint stores itself.

    The features, points and voxels are in the segments.
    """

    header: MapHeader
    keyframes: IndexedKeyframes
    submaps: IndexedSubmaps
    objects: ObjectMapState | None = None  # small, and therefore in no segment

    def write(self, file: IO[bytes], segments: Mapping[str, Segment]) -> None:
        """Write this index, with the file names, chunks and checksums of the segments.

        The rows of the segments must be on the disk already.
        """
        camera, scale_factor, num_octaves, T_map_core, *_ = self.header
        manifest = {
            'format': _FORMAT,
            'version': _VERSION,
            'camera': asdict(camera),
            'scale_factor': scale_factor,
            'num_octaves': num_octaves,
            'T_map_core': T_map_core.tolist(),
            'segments': {
                name: {'file': segment.path.name, 'crc': segment.crc}
                for name, segment in segments.items()
            },
        }
        chunks = Chunks.of(
            {name: np.array(segment.chunks, np.int64) for name, segment in segments.items()}
        )
        archive.write(file, manifest, self._records(chunks))

    def _records(self, chunks: Chunks) -> dict[str, Record]:
        records: dict[str, Record] = {
            'keyframes': self.keyframes,
            'submaps': self.submaps,
            'chunks': chunks,
        }
        if self.objects is not None:
            records['objects'] = self.objects
        return records


def read_checkpoint(path: Path) -> MapFile:
    """Return the map of an index and of the segments in the same folder, after checking them.

    Its poses are in the published map frame.

    Raises:
        MapFileError: The index or a segment is missing or damaged, or the index is of another
            version.
    """

    def read(reader: archive.Reader) -> MapFile:
        content = _content(reader, path.parent)
        check(content)
        return content

    return archive.read(path, read)


def _content(reader: archive.Reader, folder: Path) -> MapFile:
    manifest = reader.manifest()
    if (manifest.get('format'), manifest.get('version')) != (_FORMAT, _VERSION):
        raise MapFileError('is of another version of this program')
    records = reader.records(_SECTIONS, manifest['lengths'])
    chunks, segments = records['chunks'].arrays(), manifest['segments']
    rows = {
        name: Rows.read(
            folder / Path(segments[name]['file']).name,
            record,
            chunks[name].tolist(),
            segments[name]['crc'],
        )
        for name, record in SEGMENTS.items()
    }
    keyframes = cast('IndexedKeyframes', records['keyframes'])
    camera = manifest['camera'] | {'distortion': tuple(manifest['camera']['distortion'])}
    state = map_state(keyframes, rows).moved(np.array(manifest['T_map_core'], np.float64))
    dense = _submap_state(cast('IndexedSubmaps', records['submaps']), keyframes.uid, rows)
    return MapFile(
        CameraModel(**camera),
        manifest['scale_factor'],
        manifest['num_octaves'],
        state,
        dense,
        cast('ObjectMapState | None', records.get('objects')),
    )


def map_state(keyframes: IndexedKeyframes, rows: Mapping[str, Rows]) -> MapState:
    """Return the map in the core's map frame.

    Args:
        keyframes: The keyframes.
        rows: The stored rows, by segment: `features`, `states` and `points`.

    Raises:
        MapFileError: A feature observes a point that is not stored.
    """
    counts = keyframes.num_features
    features = rows['features'].taken(keyframes.first_feature, counts)
    states = rows['states'].taken(keyframes.first_state, counts)
    points = rows['points'].all()
    newest, row_of_point = _rows_of_points(points['row'], states['point'])
    _, map_id = np.unique(keyframes.map_id, return_inverse=True)
    return MapState.of(
        {
            'stamp_ns': keyframes.stamp_ns,
            'T_map_camera': keyframes.T_map_camera,
            'map_id': map_id,
            'parent': rows_of_uids(keyframes.uid, keyframes.parent_uid),
            'num_features': counts,
            **features,
            'may_seed': states['may_seed'],
            'point': row_of_point[states['point']],
            'position_m': points['position_m'][newest],
            'reference': rows_of_uids(keyframes.uid, points['reference_uid'][newest]),
            'num_visible': points['num_visible'][newest],
            'num_found': points['num_found'][newest],
        }
    )


def _rows_of_points(stored: Array, observed: Array) -> tuple[IntArray, IntArray]:
    """Return which stored rows are the points of the map, and the new row of each point.

    A point may be stored several times; the last time counts. Points that no feature observes any
    more are left out, because an atlas removes them.

    Args:
        stored: (R,) row in the atlas of each stored point, in the order of storing.
        observed: (F,) row in the atlas of the point that each feature observes, or NO_POINT.

    Returns:
        The (P,) indices into `stored` of the points of the map, and an array that maps a row in
        the atlas to the point's index among these P. The latter has NONE for rows that are left
        out, and as its last element, which the index NO_POINT = -1 reads.

    Raises:
        MapFileError: A feature observes a point that is not stored.
    """
    capacity = 1 + max(int(stored.max(initial=-1)), int(observed.max(initial=-1)))
    last = np.full(capacity, NONE)
    last[stored] = np.arange(len(stored))
    is_observed = np.zeros(capacity, np.bool_)
    is_observed[observed[observed != NO_POINT]] = True
    newest = last[is_observed]
    if (newest == NONE).any():
        raise MapFileError('lacks a point that a feature observes')
    row_of_point = np.full(capacity + 1, NONE)  # the last element is that of NO_POINT
    row_of_point[np.flatnonzero(is_observed)] = np.arange(len(newest))
    return newest, row_of_point


def _submap_state(
    submaps: IndexedSubmaps, keyframe_uids: IntArray, rows: Mapping[str, Rows]
) -> SubmapState | None:
    if len(submaps.anchor_uid) == 0:
        return None
    voxels: dict[str, Any] = rows['voxels'].taken(submaps.first_voxel, submaps.num_voxels)
    cubes = rows['cubes'].taken(submaps.cube, np.ones_like(submaps.cube))
    return SubmapState.of(
        {
            'voxel_m': submaps.voxel_m,
            'anchor': rows_of_uids(keyframe_uids, submaps.anchor_uid),
            'T_anchor_submap': submaps.T_anchor_submap,
            'num_voxels': submaps.num_voxels,
            **cubes,
            **voxels,
        }
    )
