"""RGB-D images for the dense map: usable depth readings, their surface, comparison with points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_scene.config.dense_config import CARVE_RANGE_M, DenseConfig

# Not tuned: within 3x3 pixels, a step of more than this share of the depth is a depth edge, where
# the sensor interpolates between two surfaces ("flying pixels").
_EDGE_SLOPE = 0.06
# Standard deviation of depth at 1 m [m]; it grows with the square of the depth. Khoshelham and
# Elberink (Sensors 2012) measured 1.4 mm with the Kinect; this is twice that. Not tuned.
_NOISE_PER_M2 = 0.003
_DYNAMIC = np.uint16(0x8000)  # flag of a reading; readings up to the carve range need 14 bits
_KEY_BITS = 21  # per axis, so that the key of a voxel fits into 63 bits: +-26 km at 2.5 cm
_KEY_OFFSET = 1 << (_KEY_BITS - 1)


@dataclass(frozen=True, eq=False)
class DepthView:
    """The usable readings of one RGB-D image, at every n-th pixel; see `DepthCamera.view_of`.

    Color has half the resolution of depth, because a voxel averages many pixels.
    """

    flagged_mm: NDArray[np.uint16]  # (h, w) depth; 0 = none, edge or too far; bit 15 = dynamic
    image_bgr: ByteArray  # (ceil(h / 2), ceil(w / 2), 3)

    @property
    def depth_m(self) -> Float32Array:
        """Return the (h, w) depth, on dynamic objects too: the space in front of them is free.

        It is 0 without a usable reading.
        """
        return (self.flagged_mm & ~_DYNAMIC) * np.float32(0.001)

    @property
    def is_static(self) -> BoolArray:
        """Return the (h, w) mask of pixels outside dynamic objects."""
        return np.asarray(self.flagged_mm < _DYNAMIC)


class Comparison(NamedTuple):
    """The points whose pixels in one image have a depth reading, compared with this reading."""

    rows: IntArray  # (M,) rows of the compared points
    gap_m: Float32Array  # (M,) measured depth minus point's depth; positive: surface behind
    noise_m: Float32Array  # (M,) standard deviation of the gap
    is_static: BoolArray  # (M,) whether the measured surface belongs to no dynamic object


class Surface(NamedTuple):
    """The static surface that one image measures, averaged per voxel of the map frame."""

    points_m: FloatArray  # (M, 3) mean positions; map frame, or submap's frame in `Submap.update`
    colors_bgr: FloatArray  # (M, 3) mean colors
    weights: FloatArray  # (M,) sums of the weights of the readings


class DepthCamera:
    """The camera of depth and color, with the resolution and range of the dense map."""

    def __init__(self, camera: CameraModel, config: DenseConfig) -> None:
        self._camera, self._config = camera, config
        self._rays = pixel_rays(camera, config.pixel_stride)
        self._max_slope = float(np.abs(self._rays[..., :2]).max())

    def view_of(
        self, depth_m: Float32Array, is_dynamic: BoolArray, image_bgr: ByteArray
    ) -> DepthView:
        """Return the usable readings of an image (H, W), with its dynamic pixels flagged."""
        stride = self._config.pixel_stride
        flagged_mm = (self._reliable_depth(depth_m) * 1000 + 0.5).astype(np.uint16)
        flagged_mm[is_dynamic[::stride, ::stride]] |= _DYNAMIC
        return DepthView(flagged_mm, _halved(image_bgr[::stride, ::stride]))

    def in_view(self, centers_m: FloatArray, radius_m: float) -> BoolArray:
        """Return the (N,) mask of spheres, centers (N, 3), camera frame, that may be in view."""
        x, y, z = centers_m.T
        slope = self._max_slope
        is_near = (z > -radius_m) & (z < self._config.max_depth_m + radius_m)
        spread_m = slope * z + radius_m * np.sqrt(1 + slope * slope)
        return np.asarray(is_near & (np.maximum(np.abs(x), np.abs(y)) < spread_m))

    def compare(self, points_m: Float32Array, view: DepthView) -> Comparison:
        """Compare points (N, 3) in the camera frame with the depth at their pixels."""
        depth_m, stride, camera = view.depth_m, self._config.pixel_stride, self._camera
        z = points_m[:, 2]
        index = np.flatnonzero((z > MIN_DEPTH_M) & (z < self._config.max_depth_m))
        z = z[index]
        uv_px = camera.project_px(points_m[index].astype(np.float64))
        col, row = np.rint(uv_px / stride).astype(np.int32).T
        inside = (col >= 0) & (row >= 0) & (col < depth_m.shape[1]) & (row < depth_m.shape[0])
        index, z, row, col = index[inside], z[inside], row[inside], col[inside]
        measured_m = depth_m[row, col]
        read = measured_m > 0
        index, z, row, col = index[read], z[read], row[read], col[read]
        noise_m = _NOISE_PER_M2 * z * z
        return Comparison(index, measured_m[read] - z, noise_m, view.is_static[row, col])

    def measure(self, view: DepthView, T_map_camera: FloatArray) -> Surface:
        depth_m = view.depth_m
        row, col = np.nonzero(
            view.is_static & (depth_m > 0) & (depth_m < self._config.max_depth_m)
        )
        z = depth_m[row, col].astype(np.float64)
        points = se3.transform(T_map_camera, self._rays[row, col] * z[:, None])
        colors = view.image_bgr[row // 2, col // 2]
        weight = 1.0 / z**4  # inverse variance: the standard deviation grows with depth squared
        keys, inverse = np.unique(voxel_keys(points, self._config.voxel_m), return_inverse=True)
        total = np.asarray(np.bincount(inverse, weight, len(keys)), np.float64)
        columns = [*points.T, *colors.T]
        means = [np.bincount(inverse, weight * c, len(keys)) / total for c in columns]
        return Surface(np.stack(means[:3], axis=1), np.stack(means[3:], axis=1), total)

    def _reliable_depth(self, depth_m: Float32Array) -> Float32Array:
        """Return the strided depth (h, w), with depth edges and depths from 12 m on set to 0.

        Readings between the range of the map and 12 m stay, because they carve the space in front
        of them.
        """
        stride = self._config.pixel_stride
        near = cv2.erode(depth_m, np.ones((3, 3), np.uint8))
        far = cv2.dilate(depth_m, np.ones((3, 3), np.uint8))
        good = (far - near < _EDGE_SLOPE * depth_m) & (depth_m < CARVE_RANGE_M)
        return np.ascontiguousarray(np.where(good, depth_m, np.float32(0))[::stride, ::stride])


def in_boxes(shape: tuple[int, ...], boxes_xyxy_px: Float32Array, margin_px: int) -> BoolArray:
    """Return the mask, of the given shape (H, W), of the pixels inside boxes (N, 4)."""
    out = np.zeros(shape, np.bool_)
    for x1, y1, x2, y2 in boxes_xyxy_px:  # fast enough for few boxes
        top, left = max(0, int(y1) - margin_px), max(0, int(x1) - margin_px)
        out[top : int(np.ceil(y2)) + margin_px, left : int(np.ceil(x2)) + margin_px] = True
    return out


def _halved(image_bgr: ByteArray) -> ByteArray:
    """Return an image (H, W, 3) at half the resolution, rounded up."""
    rows, columns = image_bgr.shape[:2]
    even = np.pad(image_bgr, ((0, rows % 2), (0, columns % 2), (0, 0)), 'edge')
    size = even.shape[1] // 2, even.shape[0] // 2
    return np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.uint8)


def pixel_rays(camera: CameraModel, stride: int) -> FloatArray:
    """Return the rays (h, w, 3), camera frame, z = 1, of every n-th pixel, undistorted."""
    v, u = np.mgrid[0 : camera.height_px : stride, 0 : camera.width_px : stride]
    uv = camera.undistort_px(np.stack([u, v], -1).reshape(-1, 2).astype(np.float32))
    x = (uv[:, 0] - camera.cx_px) / camera.fx_px
    y = (uv[:, 1] - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], -1).reshape(*u.shape, 3).astype(np.float64)


def voxel_keys(points_m: FloatArray, voxel_m: float) -> IntArray:
    """Return the (N,) keys of the voxels that points (N, 3) fall into."""
    cell = np.floor(points_m / voxel_m).astype(np.int64) + _KEY_OFFSET
    return (cell[:, 0] << (2 * _KEY_BITS)) | (cell[:, 1] << _KEY_BITS) | cell[:, 2]
