"""A saved map: the data from which everything else in the map can be derived.

Keyframes and points are identified by their rows. Keyframes are sorted by their uids in the map
that was saved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.io.records import Array, Record, column
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_native.results import Observations
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.loop_edge import LoopEdge, renumbered
from rgbd_slam.records.soa_table import DEAD

Int32Array = NDArray[np.int32]
NONE = -1
_BLOCK = 256  # chosen: number of keyframes whose observations are restored at once, in some ms
# Chosen: a pixel of another camera may be outside the image by this many image sizes.
_OUTSIDE = 1.0
_COLUMNS = ('stamp_ns', 'T_map_camera', 'map_id', 'num_features')
_COPIED = ('depth_m', 'octave', 'angle_deg', 'descriptors', 'may_seed')


@dataclass(frozen=True, eq=False)
class MapState(Record):
    """A saved map: K keyframes, their F features (sorted by keyframe) and P points."""

    stamp_ns: Annotated[IntArray, column('i8', 'keyframes')]
    T_map_camera: Annotated[FloatArray, column('f8', 'keyframes', 4, 4)]
    map_id: Annotated[Int32Array, column('i4', 'keyframes')]  # 0 is the oldest map
    # Row of the parent in the spanning tree; NONE for the root of a map.
    parent: Annotated[Int32Array, column('i4', 'keyframes')]
    num_features: Annotated[Int32Array, column('i4', 'keyframes')]
    uv_px: Annotated[Float32Array, column('f4', 'features', 2)]  # undistorted
    depth_m: Annotated[Float32Array, column('f4', 'features')]  # 0: no depth
    octave: Annotated[ByteArray, column('u1', 'features')]
    angle_deg: Annotated[Float32Array, column('f4', 'features')]
    descriptors: Annotated[ByteArray, column('u1', 'features', 32)]
    may_seed: Annotated[BoolArray, column('?', 'features')]
    # Row of the point that the feature observes, or NONE.
    point: Annotated[Int32Array, column('i4', 'features')]
    position_m: Annotated[FloatArray, column('f8', 'points', 3)]
    # Row of the reference keyframe, whose octave determines the range of distances for detection.
    reference: Annotated[Int32Array, column('i4', 'points')]
    num_visible: Annotated[IntArray, column('i8', 'points')]
    num_found: Annotated[IntArray, column('i8', 'points')]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def keyframe(self) -> IntArray:
        """Return the row (F,) of the keyframe to which each feature belongs."""
        return np.repeat(np.arange(len(self)), self.num_features)

    def in_camera(
        self, old: CameraModel, new: CameraModel, scale_factor: float, num_octaves: int
    ) -> MapState:
        """Return the map with the pixels and octaves that another camera would have measured.

        Pixels far outside the image, and octaves out of range, become the nearest valid ones.
        """
        rays = (self.uv_px - _center_px(old)) / _focal_px(old)
        size_px = np.array(new.size_px)
        uv_px = np.clip(
            rays * _focal_px(new) + _center_px(new), -_OUTSIDE * size_px, (1 + _OUTSIDE) * size_px
        )
        # The same detail appears larger to a camera with a longer focal length.
        larger = float(np.log(_focal_px(new) / _focal_px(old)).mean()) / np.log(scale_factor)
        octave = np.clip(np.rint(self.octave + larger), 0, num_octaves - 1)
        return replace(self, uv_px=uv_px.astype(np.float32), octave=octave.astype(np.uint8))

    def moved(self, T_new_map: FloatArray) -> MapState:
        return replace(
            self,
            T_map_camera=T_new_map @ self.T_map_camera,
            position_m=se3.transform(T_new_map, self.position_m),
        )


def _focal_px(camera: CameraModel) -> FloatArray:
    return np.array([camera.fx_px, camera.fy_px])


def _center_px(camera: CameraModel) -> FloatArray:
    return np.array([camera.cx_px, camera.cy_px])


def snapshot(atlas: Atlas) -> MapState:
    """Return a copy of all maps for saving, with ids from 0 on; takes 0.04 ms per keyframe."""
    keyframes, points = atlas.keyframes, atlas.points
    i = keyframes.indices_by_uid()
    j = points.indices()
    num_features = keyframes.num_features[i]
    features = list(zip(i.tolist(), num_features.tolist(), strict=True))
    row_of_point = np.full(points.capacity + 1, NONE)
    row_of_point[j] = np.arange(len(j))
    point = row_of_point[joined_rows(keyframes.point_of_feature, features)]
    reference = rows_of_uids(keyframes.uid[i], points.reference_keyframe_uid[j])
    _, map_id = np.unique(keyframes.map_id[i], return_inverse=True)
    return MapState.of(
        {
            'stamp_ns': keyframes.stamp_ns[i],
            'T_map_camera': keyframes.T_map_camera[i],
            'map_id': map_id,
            'parent': rows_of_uids(keyframes.uid[i], keyframes.parent_uid[i]),
            'num_features': num_features,
            'uv_px': joined_rows(keyframes.measurement_px[..., :2], features),
            **{name: joined_rows(getattr(keyframes, name), features) for name in _COPIED},
            'point': point,
            'position_m': points.position_m[j],
            'reference': reference,
            'num_visible': points.num_visible[j],
            'num_found': points.num_found[j],
        }
    )


def restore(
    atlas: Atlas,
    state: MapState,
    camera: StereoCamera,
    first_uid: int | None = None,
    *,
    keep: bool,
    loops: Sequence[LoopEdge] = (),
) -> IntArray:
    """Load a saved map into an atlas; return the rows (K,) of its keyframes.

    Args:
        atlas: The running map.
        state: The saved map, made with the same camera; it has at least one keyframe.
        camera: The camera, from which the virtual right columns of features follow.
        first_uid: The uid of the first saved keyframe; None: the next unused one.
        keep: True: keep the running map beside the saved one, with a higher map id.
        loops: Loop edges of the saved map, numbered by the rows of keyframes in `state`.
    """
    if keep:
        atlas.make_younger(1 + int(state.map_id.max()))
    else:
        atlas.clear()
    columns = {name: getattr(state, name) for name in _COLUMNS}
    features = {name: getattr(state, name) for name in _COPIED}
    features['measurement_px'] = camera.measurement_px(state.uv_px, state.depth_m)
    parent = np.where(state.parent == NONE, DEAD, state.parent)
    i = atlas.append_keyframes(columns, parent, features, first_uid)
    j = atlas.append_points(_saved_points(state), i[state.reference])
    atlas.append_observations(_observations(state, i, j), np.sort(j))
    atlas.loops += renumbered(loops, dict(enumerate(atlas.keyframes.uid[i].tolist())))
    return i


def joined_rows(table: Array, rows: Sequence[tuple[int, int]]) -> Array:
    """Return the first n entries of row i of a table (N, M, ...) for all (i, n), concatenated."""
    empty = table[:0].reshape(0, *table.shape[2:])
    return np.concatenate([empty, *(table[i, :n] for i, n in rows)])


def _saved_points(state: MapState) -> dict[str, Array]:
    point = state.point[state.point != NONE]
    with_depth = state.point[(state.point != NONE) & (state.depth_m > 0)]
    count = len(state.position_m)
    return {
        'position_m': state.position_m,
        'num_observations': np.bincount(point, minlength=count),
        'num_stereo': np.bincount(with_depth, minlength=count),
        'num_visible': state.num_visible,
        'num_found': state.num_found,
    }


def _observations(state: MapState, i: IntArray, j: IntArray) -> Iterator[Observations]:
    """Yield the observations of a saved map whose keyframes and points are in rows (K,), (P,)."""
    end = 0
    for start in range(0, len(state), _BLOCK):
        counts = state.num_features[start : start + _BLOCK]
        begin, end = end, end + int(counts.sum())
        point = state.point[begin:end]
        keyframe = np.repeat(i[start : start + _BLOCK], counts)
        k = np.arange(len(point)) - np.repeat(np.cumsum(counts) - counts, counts)
        seen = point != NONE
        yield Observations(keyframe[seen], k[seen], j[point[seen]])


def rows_of_uids(uids: IntArray, wanted: IntArray) -> Any:
    """Return the index (M,) of each `wanted` uid in the ascending `uids`; NONE if missing."""
    at = np.minimum(np.searchsorted(uids, wanted), max(len(uids) - 1, 0))
    return np.where(uids[at] == wanted, at, NONE) if len(uids) else np.full(len(wanted), NONE)
