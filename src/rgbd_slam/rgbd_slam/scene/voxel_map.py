"""Colored voxels of the static scene, with free-space carving (decision 022).

Each image adds the surface that it measures and removes the voxels that it sees through, so that
a person who stood still and then left leaves nothing behind. Readings on dynamic objects add no
surface, but the space in front of them is free as well. A voxel is confirmed when enough of the
images that observe it agree. The projective update follows Newcombe et al., KinectFusion (ISMAR
2011), sec. 3.3, with an occupancy count (Hornung et al., OctoMap, 2013) instead of a signed
distance, which would need five times as many voxels.
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

_KEY_BITS = 21  # per axis, so that a key fits into 63 bits: +-26 km at 2.5 cm
_KEY_OFFSET = 1 << (_KEY_BITS - 1)
# Not tuned: within 3x3 pixels, a step of more than this share of the depth is a depth edge, where
# the sensor interpolates between two surfaces ("flying pixels").
_EDGE_SLOPE = 0.06
# Standard deviation of depth at 1 m [m]; it grows with the square of the depth. Khoshelham and
# Elberink (Sensors 2012) measured 1.4 mm with the Kinect; this is twice that. Not tuned.
_NOISE_PER_M2 = 0.003
_MAX_HITS = 30.0  # chosen: bounds the evidence, so that a change is seen within seconds
# Chosen: a reading this far away, of any accuracy, still shows that the space nearby is free.
_CARVE_RANGE_M = 12.0
_FREE_MARGIN_M = 0.03  # a point is free if the surface behind it is this much farther; not tuned
_CARVE_WEIGHT = 3.0  # an image that sees through a voxel outweighs 3 that measured it; not tuned
_MIN_DEPTH_M = 0.1  # chosen: nearer points are behind the camera or have no reading
_DYNAMIC = np.uint16(0x8000)  # flag of a reading; readings up to the carve range need 14 bits


@dataclass(frozen=True, eq=False)
class DepthView:
    """The usable readings of one RGB-D image, at every n-th pixel; see `VoxelMap.view_of`."""

    flagged_mm: NDArray[np.uint16]  # (h, w) depth; 0 = none, edge or too far; bit 15 = dynamic
    image_bgr: ByteArray  # (h, w, 3)

    @property
    def depth_m(self) -> Float32Array:
        """Return the (h, w) depth, on dynamic objects too: the space in front of them is free."""
        return (self.flagged_mm & ~_DYNAMIC) * np.float32(0.001)

    @property
    def is_static(self) -> BoolArray:
        """Return the (h, w) mask of pixels outside dynamic objects."""
        return np.asarray(self.flagged_mm < _DYNAMIC)


class ColoredCloud(NamedTuple):
    """Points with color."""

    points_m: Float32Array  # (N, 3), map frame
    colors_bgr: ByteArray  # (N, 3)


class _Projection(NamedTuple):
    """The points that one image observes, compared with its depth."""

    rows: IntArray  # (M,) of the points
    gap_m: FloatArray  # (M,) measured depth minus the point's depth; positive: seen through
    noise_m: FloatArray  # (M,) standard deviation of the gap
    is_static: BoolArray  # (M,) the measured surface belongs to no dynamic object


class _Surface(NamedTuple):
    """The surface that one image measures, summed per voxel."""

    keys: IntArray  # (M,), sorted
    weighted: FloatArray  # (M, 7): sums of w*x, w*y, w*z, w*b, w*g, w*r, w


class VoxelMap:
    """A sparse voxel grid as a structure of arrays, sorted by key; a `SceneConsumer`."""

    def __init__(self, camera: CameraModel, config: DenseConfig) -> None:
        self._config = config
        self._rays = _pixel_rays(camera, config.pixel_stride)
        self._camera = camera
        self._keys: IntArray = np.empty(0, np.int64)
        self._sums: FloatArray = np.empty((0, 7))
        self._hits: Float32Array = np.empty(0, np.float32)  # images that measured it, less carving
        self._num_views: Float32Array = np.empty(0, np.float32)  # images that observed it

    def __len__(self) -> int:
        return len(self._keys)

    def view_of(
        self, depth_m: Float32Array, is_dynamic: BoolArray, image_bgr: ByteArray
    ) -> DepthView:
        """Return the usable readings of an image (H, W), with its dynamic pixels flagged."""
        stride = self._config.pixel_stride
        flagged_mm = (self._reliable_depth(depth_m) * 1000 + 0.5).astype(np.uint16)
        flagged_mm[is_dynamic[::stride, ::stride]] |= _DYNAMIC
        return DepthView(flagged_mm, np.ascontiguousarray(image_bgr[::stride, ::stride]))

    def integrate(self, view: DepthView, T_map_camera: FloatArray) -> None:
        """Carve the voxels that an image sees through, then add the surface that it measures."""
        agrees = self._compare(view, T_map_camera)
        self._add(self._measure(view, T_map_camera), agrees)
        self._remove_weak()

    def cloud(self) -> ColoredCloud:
        """Return the mean point and color of each confirmed voxel."""
        sums = self._sums[self._is_confirmed()]
        mean = sums[:, :6] / sums[:, 6:]
        return ColoredCloud(mean[:, :3].astype(np.float32), mean[:, 3:].round().astype(np.uint8))

    def unconfirmed_m(self) -> FloatArray:
        """Return the (N, 3) points that too few images have measured so far."""
        sums = self._sums[~self._is_confirmed()]
        return np.asarray(sums[:, :3] / sums[:, 6:])

    def _is_confirmed(self) -> BoolArray:
        agreed = self._hits >= self._config.min_hit_share * self._num_views
        return np.asarray(agreed & (self._hits >= self._config.min_views))

    def clear(self) -> None:
        """Discard all voxels."""
        self._keep(np.zeros(len(self), bool))

    def _reliable_depth(self, depth_m: Float32Array) -> Float32Array:
        """Return the strided depth (h, w) with depth edges set to 0.

        Readings beyond the range of the map stay, because they carve the space in front of them.
        """
        stride = self._config.pixel_stride
        near = cv2.erode(depth_m, np.ones((3, 3), np.uint8))
        far = cv2.dilate(depth_m, np.ones((3, 3), np.uint8))
        good = (far - near < _EDGE_SLOPE * depth_m) & (depth_m < _CARVE_RANGE_M)
        return np.ascontiguousarray(np.where(good, depth_m, np.float32(0))[::stride, ::stride])

    def _compare(self, view: DepthView, T_map_camera: FloatArray) -> BoolArray:
        """Carve the voxels that the image sees through; return the (N,) mask of those it confirms.

        A measured surface confirms the voxels within half a voxel of it, not only the one that it
        falls into: a surface on the border of two voxels falls into either at random.
        """
        agrees = np.zeros(len(self), np.bool_)
        if len(self) == 0:
            return agrees
        points_m = self._sums[:, :3] / self._sums[:, 6:]
        seen = self._project(points_m, view, T_map_camera)
        margin_m = self._config.carve_margin_m + seen.noise_m
        near_m = 0.5 * self._config.voxel_m + seen.noise_m
        distance_m = np.abs(seen.gap_m)
        self._hits[seen.rows[seen.gap_m > margin_m]] -= _CARVE_WEIGHT
        self._num_views[seen.rows[seen.is_static & (distance_m <= margin_m)]] += 1
        agrees[seen.rows[seen.is_static & (distance_m <= near_m)]] = True
        return agrees

    def sees_through(
        self, points_m: FloatArray, view: DepthView, T_map_camera: FloatArray
    ) -> BoolArray:
        """Return the (N,) mask of the points (N, 3) that an image shows to be in free space."""
        out = np.zeros(len(points_m), np.bool_)
        seen = self._project(points_m, view, T_map_camera)
        out[seen.rows[seen.gap_m > _FREE_MARGIN_M + seen.noise_m]] = True
        return out

    def _project(
        self, points_m: FloatArray, view: DepthView, T_map_camera: FloatArray
    ) -> _Projection:
        """Compare points (N, 3) in the map frame with the depth at their pixels."""
        depth_m = view.depth_m
        stride = self._config.pixel_stride
        camera = self._camera
        points = se3.transform(se3.inverse(T_map_camera), points_m)
        z = points[:, 2]
        index = np.flatnonzero((z > _MIN_DEPTH_M) & (z < self._config.max_depth_m))
        z = z[index]
        col, row = np.rint(camera.project_px(points[index]) / stride).astype(np.int64).T
        inside = (col >= 0) & (row >= 0) & (col < depth_m.shape[1]) & (row < depth_m.shape[0])
        index, z, row, col = index[inside], z[inside], row[inside], col[inside]
        read = depth_m[row, col] > 0
        index, z, row, col = index[read], z[read], row[read], col[read]
        gap_m = depth_m[row, col] - z
        return _Projection(index, gap_m, _NOISE_PER_M2 * z * z, view.is_static[row, col])

    def _measure(self, view: DepthView, T_map_camera: FloatArray) -> _Surface:
        depth_m = view.depth_m
        valid = view.is_static & (depth_m > 0) & (depth_m < self._config.max_depth_m)
        z = depth_m[valid].astype(np.float64)
        points = se3.transform(T_map_camera, self._rays[valid] * z[:, None])
        colors = view.image_bgr[valid]
        weight = 1.0 / z**4  # inverse variance: the standard deviation grows with depth squared
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
        self._num_views = np.insert(self._num_views, at[fresh], ones)

    def _remove_weak(self) -> None:
        """Remove carved voxels and, beyond `max_voxels`, those with the least evidence."""
        self._num_views[self._num_views > _MAX_HITS] = _MAX_HITS
        keep = self._hits > 0
        if int(keep.sum()) > self._config.max_voxels:
            keep[np.argsort(-self._hits, kind='stable')[self._config.max_voxels :]] = False
        if not keep.all():
            self._keep(keep)

    def _keep(self, keep: BoolArray) -> None:
        self._keys, self._sums = self._keys[keep], self._sums[keep]
        self._hits, self._num_views = self._hits[keep], self._num_views[keep]


def in_boxes(shape: tuple[int, ...], boxes_xyxy_px: Float32Array, margin_px: int) -> BoolArray:
    """Return the (H, W) mask of the pixels inside boxes (N, 4) enlarged by a margin."""
    out = np.zeros(shape, np.bool_)
    for x1, y1, x2, y2 in boxes_xyxy_px:  # a handful of dynamic objects
        top, left = max(0, int(y1) - margin_px), max(0, int(x1) - margin_px)
        out[top : int(np.ceil(y2)) + margin_px, left : int(np.ceil(x2)) + margin_px] = True
    return out


def _pixel_rays(camera: CameraModel, stride: int) -> FloatArray:
    """Return the (h, w, 3) rays with z = 1 of every n-th pixel, without lens distortion."""
    v, u = np.mgrid[0 : camera.height_px : stride, 0 : camera.width_px : stride]
    uv = camera.undistort_px(np.stack([u, v], -1).reshape(-1, 2).astype(np.float32))
    x = (uv[:, 0] - camera.cx_px) / camera.fx_px
    y = (uv[:, 1] - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], -1).reshape(*u.shape, 3).astype(np.float64)


def _keys_of(points_m: FloatArray, voxel_m: float) -> IntArray:
    """Return the (N,) keys of the voxels that points (N, 3) fall into."""
    cell = np.floor(points_m / voxel_m).astype(np.int64) + _KEY_OFFSET
    return (cell[:, 0] << (2 * _KEY_BITS)) | (cell[:, 1] << _KEY_BITS) | cell[:, 2]
