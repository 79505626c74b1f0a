"""A depth image as the object map uses it: reliable readings as points of the map frame."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import CameraModel, Float32Array, FloatArray, IntArray

# None of these numbers was tuned.
_STRIDE = 4  # step between the pixels used [px]: 2.3 cm at 3 m, about a voxel
_MIN_RANGE_M, _MAX_RANGE_M = 0.3, 6.0  # farther away, the noise of depth hides small objects
# A pixel is at a depth edge, where the sensor interpolates between two surfaces, if the depths in
# the 3x3 pixels around it span at least the sum of this share of its depth and so many standard
# deviations.
_EDGE_SLOPE, _EDGE_NOISE = 0.04, 5.0
# Standard deviation of depth at 1 m [m], which grows with the square of the depth (as in
# `depth_view`, after Khoshelham and Elberink, Sensors 2012).
NOISE_PER_M2 = 0.003
# A measured surface contains a point if their depths differ by at most this length plus two
# standard deviations.
_SURFACE_M = 0.06


class Projection(NamedTuple):
    """What an image shows at the pixels of N points.

    A point is visible if the size of its gap is at most the margin, and seen through if its gap is
    larger. Otherwise it is occluded, or nothing is known of it.
    """

    uv_px: FloatArray  # (N, 2) in strided pixels; NaN if the point is out of view or range
    gap_m: FloatArray  # (N,) measured depth minus that of the point; NaN without a reading
    margin_m: FloatArray  # (N,) largest gap with which the measured surface contains the point


class ObjectView:
    """Every fourth pixel of a depth image, as points of the map frame.

    Attributes:
        depth_m: (h, w) depth; 0: no reliable reading.
        points_map_m: (h * w, 3) points of the map frame; the camera's position where there is no
            reliable reading.
        T_map_camera: (4, 4) pose of the image.
    """

    def __init__(
        self, camera: ObjectCamera, depth_m: Float32Array, T_map_camera: FloatArray
    ) -> None:
        self._camera = camera
        self.T_map_camera = T_map_camera
        self.depth_m = _reliable(depth_m)
        rays = camera.rays * self.depth_m.reshape(-1, 1)
        self.points_map_m = se3.transform(T_map_camera, rays)

    @property
    def shape(self) -> tuple[int, int]:
        """Return the height and the width in strided pixels."""
        height, width = self.depth_m.shape
        return height, width

    @property
    def pixel_m(self) -> float:
        """Return the distance [m] between neighboring strided pixels at a depth of 1 m."""
        return _STRIDE / self._camera.model.fx_px

    def pixels_of(self, box_xyxy_px: tuple[float, ...]) -> tuple[int, int, int, int]:
        """Return left, top, right and bottom of a box in strided pixels, cut at the border.

        Args:
            box_xyxy_px: Left, top, right and bottom in pixels of the full image.
        """
        height, width = self.depth_m.shape
        low = np.floor(np.array(box_xyxy_px[:2]) / _STRIDE).astype(int)
        high = np.ceil(np.array(box_xyxy_px[2:]) / _STRIDE).astype(int)
        left, top = np.clip(low, 0, (width, height)).tolist()
        right, bottom = np.clip(high, (left, top), (width, height)).tolist()
        return left, top, right, bottom

    def project(self, points_map_m: FloatArray) -> Projection:
        """Compare points (N, 3) of the map frame with the measured depth at their pixels."""
        points = se3.transform(se3.inverse(self.T_map_camera), points_map_m)
        z = points[:, 2]
        uv, gap = np.full((len(points), 2), np.nan), np.full(len(points), np.nan)
        ahead = np.flatnonzero((z > _MIN_RANGE_M) & (z < _MAX_RANGE_M))
        found = self._camera.model.project_px(points[ahead]) / _STRIDE
        col, row = np.rint(found).astype(np.int64).T
        height, width = self.depth_m.shape
        inside = (col >= 0) & (row >= 0) & (col < width) & (row < height)
        index = ahead[inside]
        uv[index] = found[inside]
        measured = self.depth_m[row[inside], col[inside]]
        gap[index] = np.where(measured > 0, measured - z[index], np.nan)
        return Projection(uv, gap, _SURFACE_M + 2 * NOISE_PER_M2 * z * z)


class ObjectCamera:
    """A camera with the viewing rays of every fourth pixel.

    Attributes:
        model: The camera.
        rays: (h * w, 3) points of the rays with z = 1, in the camera frame.
    """

    def __init__(self, model: CameraModel) -> None:
        self.model = model
        v, u = np.mgrid[0 : model.height_px : _STRIDE, 0 : model.width_px : _STRIDE]
        uv = model.undistort_px(np.stack([u, v], -1).reshape(-1, 2).astype(np.float32))
        x = (uv[:, 0] - model.cx_px) / model.fx_px
        y = (uv[:, 1] - model.cy_px) / model.fy_px
        self.rays: FloatArray = np.stack([x, y, np.ones_like(x)], -1).astype(np.float64)

    def view(self, depth_m: Float32Array, T_map_camera: FloatArray) -> ObjectView:
        """Return the view of a depth image (H, W) with its pose (4, 4)."""
        return ObjectView(self, depth_m, T_map_camera)


def readings_in(view: ObjectView, left: int, top: int, right: int, bottom: int) -> IntArray:
    """Return the flat indices (M,) of the pixels with a reliable reading in a box.

    All are strided pixels; the box excludes `right` and `bottom`.
    """
    row, col = np.nonzero(view.depth_m[top:bottom, left:right])
    return np.asarray((row + top) * view.shape[1] + col + left, np.int64)


def _reliable(depth_m: Float32Array) -> Float32Array:
    """Return the strided depth (h, w) of a full depth image; 0 at depth edges and out of range."""
    depth = depth_m[::_STRIDE, ::_STRIDE]
    height, width = depth.shape
    padded = cv2.copyMakeBorder(depth_m, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    near, far = depth.copy(), depth.copy()
    for dy, dx in product(range(3), range(3)):  # the 3x3 pixels around each strided pixel
        part = padded[dy::_STRIDE, dx::_STRIDE][:height, :width]
        np.minimum(near, part, out=near)
        np.maximum(far, part, out=far)
    limit = _EDGE_SLOPE * depth + _EDGE_NOISE * NOISE_PER_M2 * depth * depth
    good = (far - near < limit) & (depth > _MIN_RANGE_M) & (depth < _MAX_RANGE_M)
    return np.ascontiguousarray(np.where(good, depth, np.float32(0)))
