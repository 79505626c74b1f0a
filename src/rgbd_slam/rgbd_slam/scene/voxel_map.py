"""Coloured voxels of the static room, carved by free space.

Each image adds the surface it measures and takes away what it looks through, so that somebody
who stood still and then left leaves nothing behind. Readings of what is dynamic add nothing, but
what is before them is free as well. A voxel is shown when enough of the images
that look at it agree. The projective update follows Newcombe et al., KinectFusion (ISMAR 2011),
sec. 3.3, with an occupancy count (Hornung et al., OctoMap, 2013) in place of a signed distance,
which needs a fifth of the voxels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

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

_KEY_BITS = 21  # per axis: +-26 km at 2.5 cm
_KEY_OFFSET = 1 << (_KEY_BITS - 1)
_EDGE_SLOPE = 0.06  # a depth step of more than this share of the depth is an edge
_NOISE_PER_M2 = 0.003  # 1 sigma of a structured-light or time-of-flight reading at 1 m (m)
_MAX_HITS = 30.0  # evidence is capped, so that a change of the room is seen within seconds
_CARVE_RANGE_M = 12.0  # a reading so far away says at least that nothing is near
_CLEAR_M = 0.03  # a surface so much farther than a point leaves it free
_CARVE_FACTOR = 3.0  # looking through a voxel weighs more than measuring it
_DYNAMIC = np.uint16(0x8000)  # flag of a reading, which carve range leaves unused


@dataclass(frozen=True, eq=False)
class DepthView:
    """What can be trusted of one RGB-D image, every n-th pixel; see `VoxelMap.view_of`."""

    flagged_mm: NDArray[np.uint16]  # (h, w) depth, or 0 = no reading, edge or too far; see below
    image_bgr: ByteArray  # (h, w, 3)

    @property
    def depth_m(self) -> Float32Array:
        """Return (h, w) readings, also of what is dynamic: what is before them is free."""
        return (self.flagged_mm & ~_DYNAMIC) * np.float32(0.001)

    @property
    def is_static(self) -> BoolArray:
        """Return (h, w) which readings may be surface of the room: the highest bit is not set."""
        return np.asarray(self.flagged_mm < _DYNAMIC)


class ColoredCloud(NamedTuple):
    """Points with colour."""

    points_m: Float32Array  # (N, 3), map frame
    colors_bgr: ByteArray  # (N, 3)


class _Look(NamedTuple):
    """What one image says of the points that it looks at."""

    rows: IntArray  # (M,) of the points
    gap_m: FloatArray  # (M,) from the point to the surface seen, positive when that is behind
    noise_m: FloatArray  # (M,) of the gap
    is_static: BoolArray  # (M,) the surface seen is none of a person's or a handled object's


class _Surface(NamedTuple):
    """What one image measures, gathered per voxel."""

    keys: IntArray  # (M,), sorted
    weighted: FloatArray  # (M, 7): sums of w*x, w*y, w*z, w*b, w*g, w*r, w


class VoxelMap:
    """A sparse voxel grid as structure of arrays, sorted by key."""

    def __init__(self, camera: CameraModel, config: DenseConfig) -> None:
        self._config = config
        self._rays = _pixel_rays(camera, config.pixel_stride)
        self._camera = camera
        self._keys: IntArray = np.empty(0, np.int64)
        self._sums: FloatArray = np.empty((0, 7))
        self._hits: Float32Array = np.empty(0, np.float32)  # images that measured it, less carving
        self._looks: Float32Array = np.empty(0, np.float32)  # images that looked at it

    def __len__(self) -> int:
        return len(self._keys)

    def view_of(
        self, depth_m: Float32Array, is_dynamic: BoolArray, image_bgr: ByteArray
    ) -> DepthView:
        """Return what can be trusted of depth and dynamic pixels (H, W) and colour (H, W, 3)."""
        stride = self._config.pixel_stride
        flagged_mm = (self._reliable_depth(depth_m) * 1000 + 0.5).astype(np.uint16)
        flagged_mm[is_dynamic[::stride, ::stride]] |= _DYNAMIC
        return DepthView(flagged_mm, np.ascontiguousarray(image_bgr[::stride, ::stride]))

    def integrate(self, view: DepthView, T_map_camera: FloatArray) -> None:
        """Carve what the image looks through, then add the surface it measures."""
        agrees = self._compare(view, T_map_camera)
        self._add(self._measure(view, T_map_camera), agrees)
        self._forget()

    def cloud(self) -> ColoredCloud:
        """Return the voxels that enough images agree on."""
        sums = self._sums[self._is_shown()]
        mean = sums[:, :6] / sums[:, 6:]
        return ColoredCloud(mean[:, :3].astype(np.float32), mean[:, 3:].round().astype(np.uint8))

    def doubtful_m(self) -> FloatArray:
        """Return (N, 3) what was measured, but not by enough images to be shown."""
        sums = self._sums[~self._is_shown()]
        return np.asarray(sums[:, :3] / sums[:, 6:])

    def _is_shown(self) -> BoolArray:
        agreed = self._hits >= self._config.min_hit_share * self._looks
        return np.asarray(agreed & (self._hits >= self._config.min_views))

    def clear(self) -> None:
        """Forget everything."""
        self._keep(np.zeros(len(self), bool))

    def _reliable_depth(self, depth_m: Float32Array) -> Float32Array:
        """Return the strided depth with depth edges (flying pixels) set to 0.

        Far readings stay: they are no surface to map, but what is before them is free.
        """
        stride = self._config.pixel_stride
        near = cv2.erode(depth_m, np.ones((3, 3), np.uint8))
        far = cv2.dilate(depth_m, np.ones((3, 3), np.uint8))
        good = (far - near < _EDGE_SLOPE * depth_m) & (depth_m < _CARVE_RANGE_M)
        return np.ascontiguousarray(np.where(good, depth_m, np.float32(0))[::stride, ::stride])

    def _compare(self, view: DepthView, T_map_camera: FloatArray) -> BoolArray:
        """Carve the voxels that the image looks through, and return (N,) which ones it confirms.

        A surface on the border of two voxels is measured in either by turns: a voxel is confirmed
        by what is measured within half a voxel of it, not by what falls into it.
        """
        agrees = np.zeros(len(self), np.bool_)
        if len(self) == 0:
            return agrees
        points_m = self._sums[:, :3] / self._sums[:, 6:]
        look = self._look_at(points_m, view, T_map_camera)
        margin_m = self._config.carve_margin_m + look.noise_m
        near_m = 0.5 * self._config.voxel_m + look.noise_m
        distance_m = np.abs(look.gap_m)
        self._hits[look.rows[look.gap_m > margin_m]] -= _CARVE_FACTOR
        self._looks[look.rows[look.is_static & (distance_m <= margin_m)]] += 1
        agrees[look.rows[look.is_static & (distance_m <= near_m)]] = True
        return agrees

    def looks_through(
        self, points_m: FloatArray, view: DepthView, T_map_camera: FloatArray
    ) -> BoolArray:
        """Return which of (N, 3) points an image shows to be free."""
        out = np.zeros(len(points_m), np.bool_)
        look = self._look_at(points_m, view, T_map_camera)
        out[look.rows[look.gap_m > _CLEAR_M + look.noise_m]] = True
        return out

    def _look_at(self, points_m: FloatArray, view: DepthView, T_map_camera: FloatArray) -> _Look:
        depth_m = view.depth_m
        stride = self._config.pixel_stride
        camera = self._camera
        points = se3.transform(se3.inverse(T_map_camera), points_m)
        z = points[:, 2]
        index = np.flatnonzero((z > 0.1) & (z < self._config.max_depth_m))
        z = z[index]
        col, row = np.rint(camera.project_px(points[index]) / stride).astype(np.int64).T
        inside = (col >= 0) & (row >= 0) & (col < depth_m.shape[1]) & (row < depth_m.shape[0])
        index, z, row, col = index[inside], z[inside], row[inside], col[inside]
        read = depth_m[row, col] > 0
        index, z, row, col = index[read], z[read], row[read], col[read]
        gap_m = depth_m[row, col] - z
        return _Look(index, gap_m, _NOISE_PER_M2 * z * z, view.is_static[row, col])

    def _measure(self, view: DepthView, T_map_camera: FloatArray) -> _Surface:
        depth_m = view.depth_m
        valid = view.is_static & (depth_m > 0) & (depth_m < self._config.max_depth_m)
        z = depth_m[valid].astype(np.float64)
        points = se3.transform(T_map_camera, self._rays[valid] * z[:, None])
        colors = view.image_bgr[valid]
        weight = 1.0 / z**4  # inverse variance: the noise grows with depth squared
        keys, inverse = np.unique(_keys_of(points, self._config.voxel_m), return_inverse=True)
        columns = [points[:, 0], points[:, 1], points[:, 2], *colors.T]
        sums = [np.bincount(inverse, weight * c, len(keys)) for c in columns]
        return _Surface(keys, np.stack([*sums, np.bincount(inverse, weight, len(keys))], axis=1))

    def _add(self, surface: _Surface, agrees: BoolArray) -> None:
        at = np.searchsorted(self._keys, surface.keys)
        known = np.zeros(len(at), bool)
        inside = at < len(self)
        known[inside] = self._keys[at[inside]] == surface.keys[inside]
        self._sums[at[known]] += surface.weighted[known]
        agrees[at[known]] = True
        self._hits[agrees] = np.minimum(np.maximum(self._hits[agrees], 0) + 1, _MAX_HITS)
        fresh = ~known
        ones = np.ones(int(fresh.sum()), np.float32)
        self._keys = np.insert(self._keys, at[fresh], surface.keys[fresh])
        self._sums = np.insert(self._sums, at[fresh], surface.weighted[fresh], axis=0)
        self._hits = np.insert(self._hits, at[fresh], ones)
        self._looks = np.insert(self._looks, at[fresh], ones)

    def _forget(self) -> None:
        """Drop carved voxels and, over the memory bound, those with the least evidence."""
        capped = self._looks > _MAX_HITS
        self._looks[capped] = _MAX_HITS
        keep = self._hits > 0
        if int(keep.sum()) > self._config.max_voxels:
            keep[np.argsort(-self._hits, kind='stable')[self._config.max_voxels :]] = False
        if not keep.all():
            self._keep(keep)

    def _keep(self, keep: BoolArray) -> None:
        self._keys, self._sums = self._keys[keep], self._sums[keep]
        self._hits, self._looks = self._hits[keep], self._looks[keep]


def in_boxes(shape: tuple[int, ...], boxes_xyxy_px: Float32Array, margin_px: int) -> BoolArray:
    """Return (H, W) which pixels lie inside the (N, 4) boxes grown by the margin."""
    out = np.zeros(shape, np.bool_)
    for x1, y1, x2, y2 in boxes_xyxy_px:  # a handful of dynamic objects
        top, left = max(0, int(y1) - margin_px), max(0, int(x1) - margin_px)
        out[top : int(np.ceil(y2)) + margin_px, left : int(np.ceil(x2)) + margin_px] = True
    return out


def _pixel_rays(camera: CameraModel, stride: int) -> FloatArray:
    """Return (h, w, 3) rays with z = 1 of the strided pixels, distortion removed."""
    v, u = np.mgrid[0 : camera.height_px : stride, 0 : camera.width_px : stride]
    uv = camera.undistort_px(np.stack([u, v], -1).reshape(-1, 2).astype(np.float32))
    x = (uv[:, 0] - camera.cx_px) / camera.fx_px
    y = (uv[:, 1] - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], -1).reshape(*u.shape, 3).astype(np.float64)


def _keys_of(points_m: FloatArray, voxel_m: float) -> IntArray:
    cell = np.floor(points_m / voxel_m).astype(np.int64) + _KEY_OFFSET
    return (cell[:, 0] << (2 * _KEY_BITS)) | (cell[:, 1] << _KEY_BITS) | cell[:, 2]
