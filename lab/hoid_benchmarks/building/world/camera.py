"""The features that an RGB-D camera with an ORB extractor reports in a building."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from hoid_benchmarks.building.world.floors import Building, Cell, Opening
from hoid_benchmarks.building.world.landmarks import DESCRIPTOR_BYTES, Landmarks, LandmarkStore
from hoid_common.values import (
    ByteArray,
    CameraModel,
    Features,
    Float32Array,
    FloatArray,
    IntArray,
)

MODEL = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
NO_LANDMARK = -1  # id of a spurious feature
_RANGE_M = (0.3, 6.0)
_WIDEST = 0.62  # more than the largest x / z and y / z in an image
_MIN_COSINE = 0.2  # of the angle between the line of sight and the normal of a landmark
_SCALE_FACTOR, _NUM_OCTAVES = 1.2, 8
_MAX_FEATURES = 1000
_CELL_PX, _MAX_PER_CELL = 40, 10
_PIXEL_SIGMA = 0.5  # px at octave 0
_ANGLE_SIGMA_DEG = 3.0
_DEPTH_NOISE = 1.2e-3  # standard deviation of depth z: this times z^2
_FLIPPED_SHARE = 0.04  # of the bits of a descriptor, at random
# Views from this angle on flip bits of `side_bits`; all of them from a further radian on.
_OBLIQUE_RAD = 0.3
_MISSING_DEPTH_SHARE = 0.10
_SPURIOUS_SHARE = 0.05
_FLICKER = 0.15  # standard deviation of the corner strength from image to image


@dataclass(frozen=True, eq=False)
class _Views:
    """N landmarks as seen in one image, before noise."""

    uv_px: Float32Array
    depth_m: Float32Array
    octave: Float32Array
    response: Float32Array
    angle_deg: Float32Array
    descriptors: ByteArray
    side_bits: ByteArray  # (N, 32) descriptor bits that flip in oblique views from this side
    obliqueness: Float32Array  # (N,) in [0, 1]: share of these bits that flip
    ids: IntArray

    def at(self, rows: IntArray) -> _Views:
        """Return the views of some landmarks, given by their rows."""
        return _Views(*(getattr(self, f.name)[rows] for f in fields(self)))


class FeatureCamera:
    """Observes a building; the same seed and poses give the same features.

    Args:
        building: The building that the camera looks at.
        seed: Seed of the noise.
    """

    def __init__(self, building: Building, seed: int = 0) -> None:
        self._building = building
        self._landmarks = LandmarkStore(building)
        self._rng = np.random.default_rng([seed, 99])
        self._cell: Cell | None = None
        # Obliqueness from which each bit flips.
        self._bit_threshold = np.random.default_rng(5).random(8 * DESCRIPTOR_BYTES, np.float32)
        self.landmark_ids: IntArray = np.empty(0, np.int64)  # of the last image, or NO_LANDMARK

    def observe(self, T_world_camera: FloatArray, stamp_ns: int) -> Features:
        """Return the features of an image taken at a pose (4, 4) of the optical frame."""
        self._cell = self._building.cell_at(T_world_camera[:3, 3], self._cell)
        seen = [
            views
            for cell, openings in self._cells_in_sight(self._cell)
            if (views := self._views(cell, openings, T_world_camera)) is not None
        ]
        views = _Views(
            *(np.concatenate([getattr(v, f.name) for v in seen]) for f in fields(_Views))
        )
        return self._detected(views, stamp_ns)

    def _cells_in_sight(self, cell: Cell) -> Iterator[tuple[Cell, tuple[Opening, ...]]]:
        """Yield cells up to two openings away, with the openings in between."""
        cells = self._building.cells
        yield cell, ()
        for near, first in cell.neighbors:
            yield cells[near], (first,)
            for far, second in cells[near].neighbors:
                if far != cell.key:
                    yield cells[far], (first, second)

    def _views(
        self, cell: Cell, openings: tuple[Opening, ...], T_world_camera: FloatArray
    ) -> _Views | None:
        """Return the visible landmarks of a cell, or None if it is out of sight."""
        if _is_out_of_sight(cell, T_world_camera):
            return None
        landmarks = self._landmarks.of(cell)
        eye_m = T_world_camera[:3, 3].astype(np.float32)
        along_m = landmarks.position_m[:, landmarks.axis]
        reach_m = eye_m[landmarks.axis] + np.array([-_RANGE_M[1], _RANGE_M[1]], np.float32)
        near = slice(*np.searchsorted(along_m, reach_m).tolist())
        ray_m = landmarks.position_m[near] - eye_m
        camera_m = ray_m @ T_world_camera[:3, :3].astype(np.float32)
        x, y, z = camera_m.T
        may_show = (z > _RANGE_M[0]) & (z < _RANGE_M[1])
        may_show &= (np.abs(x) < _WIDEST * z) & (np.abs(y) < _WIDEST * z)
        ahead = np.flatnonzero(may_show)
        uv_px = MODEL.project_px(camera_m[ahead].astype(np.float64))
        u, v = uv_px.T
        inside = (u >= 0) & (v >= 0) & (u < MODEL.width_px) & (v < MODEL.height_px)
        k, uv_px = ahead[inside], uv_px[inside]
        rows, ray_m, z = near.start + k, ray_m[k], z[k]
        distance_m = np.linalg.norm(ray_m, axis=1)
        cosine = -np.vecdot(ray_m, landmarks.normal[rows]) / distance_m
        ratio = np.log(landmarks.max_range_m[rows] / distance_m)
        octave = np.floor(ratio / np.log(_SCALE_FACTOR))
        visible = (cosine > _MIN_COSINE) & (octave >= 0) & (octave < _NUM_OCTAVES)
        for opening in openings:
            visible[visible] = opening.passes(eye_m, landmarks.position_m[rows[visible]])
        return _as_seen(
            landmarks,
            rows[visible],
            ray_m[visible],
            cosine[visible],
            (uv_px[visible].astype(np.float32), z[visible], octave[visible]),
        )

    def _detected(self, views: _Views, stamp_ns: int) -> Features:
        """Return the strongest features of each image cell, with noise and spurious ones."""
        rng = self._rng
        flicker = rng.normal(0, _FLICKER, len(views.ids)).astype(np.float32)
        views = views.at(_strongest(views.uv_px, views.response + flicker))
        n = len(views.ids)
        sigma_px = _PIXEL_SIGMA * _SCALE_FACTOR ** (0.6 * views.octave)
        uv_px = views.uv_px + rng.normal(0, 1, (n, 2)) * sigma_px[:, None]
        depth_m = views.depth_m + rng.normal(0, 1, n) * _DEPTH_NOISE * views.depth_m**2
        depth_m[rng.random(n) < _MISSING_DEPTH_SHARE] = 0
        bits = np.unpackbits(views.descriptors, axis=1)
        bits ^= rng.random(bits.shape, np.float32) < _FLIPPED_SHARE
        side = np.unpackbits(views.side_bits, axis=1).view(np.bool_)
        bits ^= side & (self._bit_threshold < views.obliqueness[:, None])
        angle_deg = views.angle_deg + rng.normal(0, _ANGLE_SIGMA_DEG, n)
        m = int(_SPURIOUS_SHARE * n)
        last_px = (MODEL.width_px - 1, MODEL.height_px - 1)
        angles_deg = np.concatenate([angle_deg, rng.uniform(0, 360, m)]) % 360
        self.landmark_ids = np.concatenate([views.ids, np.full(m, NO_LANDMARK)])
        return Features(
            stamp_ns,
            np.concatenate([uv_px, rng.uniform((0, 0), last_px, (m, 2))]).astype(np.float32),
            np.concatenate([depth_m, rng.uniform(0.5, 5, m)]).astype(np.float32),
            np.concatenate([views.octave, rng.integers(0, _NUM_OCTAVES, m)]).astype(np.uint8),
            angles_deg.astype(np.float32) % np.float32(360),  # rounding may give 360
            np.ones(n + m, np.float32),
            np.concatenate(
                [
                    np.packbits(bits, axis=1),
                    rng.integers(0, 256, (m, DESCRIPTOR_BYTES), dtype=np.uint8),
                ]
            ),
            np.ones(n + m, np.bool_),
        )


def _is_out_of_sight(cell: Cell, T_world_camera: FloatArray) -> bool:
    """Return whether a cell is out of range or behind the camera as a whole."""
    eye_m, ahead = T_world_camera[:3, 3], T_world_camera[:3, 2]
    nearest_m = np.clip(eye_m, cell.low_m, cell.high_m)
    farthest_m = np.where(ahead > 0, cell.high_m, cell.low_m)  # along the viewing direction
    is_far = np.linalg.norm(nearest_m - eye_m) > _RANGE_M[1]
    return bool(is_far or (farthest_m - eye_m) @ ahead < 0)


def _as_seen(
    landmarks: Landmarks,
    rows: IntArray,
    ray_m: Float32Array,
    cosine: Float32Array,
    where: tuple[Float32Array, Float32Array, Float32Array],
) -> _Views:
    """Return the views of landmarks (N,) along rays (N, 3); `where` is pixel, depth and octave."""
    normal = landmarks.normal[rows]
    from_right = ray_m[:, 0] * normal[:, 1] - ray_m[:, 1] * normal[:, 0] > 0
    angle_rad = np.arccos(np.clip(cosine, 0, 1))
    return _Views(
        *where,
        landmarks.response[rows],
        landmarks.angle_deg[rows],
        landmarks.descriptors[rows],
        landmarks.side_bits[rows, from_right.astype(np.int64)],
        np.clip(angle_rad - _OBLIQUE_RAD, 0, 1).astype(np.float32),
        landmarks.ids[rows],
    )


def _strongest(uv_px: Float32Array, score: Float32Array) -> IntArray:
    """Return the rows of the strongest features of each image cell and of all, strongest first."""
    column, row = (uv_px // _CELL_PX).astype(np.int64).T
    cell = row * (MODEL.width_px // _CELL_PX + 1) + column
    order = np.lexsort((-score, cell))
    sorted_cell = cell[order]
    rank = np.arange(len(order)) - np.searchsorted(sorted_cell, sorted_cell)
    order = order[rank < _MAX_PER_CELL]
    strongest: IntArray = order[np.argsort(-score[order], kind='stable')[:_MAX_FEATURES]]
    return strongest
