"""A depth image as the object map uses it: reliable readings as points of the map frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import (
    BoolArray,
    CameraModel,
    DynamicObject,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_native import seen_voxels
from hoid_native.results import SeenVoxels
from hoid_scene.dense.depth_view import pixel_rays

# None of these numbers was tuned.
_MIN_RANGE_M, _MAX_RANGE_M = 0.3, 6.0  # farther away, the noise of depth hides small objects
# A pixel is at a depth edge, where the sensor interpolates between two surfaces, if the depths in
# the 3x3 pixels around it span at least the sum of this share of its depth and so many standard
# deviations.
_EDGE_SLOPE, _EDGE_NOISE = 0.04, 5.0
_SCREENS = frozenset({'tv', 'laptop', 'cell phone'})
# Chosen: a box shows a dark screen if at least this ratio of its pixels has no depth (holes), and
# at least so many readings are in this neighborhood of the holes. The readings of the screen's
# frame are those in the nearest layer of depth, of so many bins of this thickness, with at least
# 0.6 times the readings of the fullest layer, and those within this distance, or one standard
# deviation of depth, of the plane through them.
_SCREEN_HOLES, _FRAME_READINGS, _FRAME_AREA = 0.4, 30, np.ones((5, 5), np.uint8)
_FRAME_BIN_M, _FRAME_BINS, _FRAME_NEARER = 0.05, 3, 0.6
_FRAME_M = 0.03
STRIDE = 4  # step between the pixels used [px]: 2.3 cm at 3 m, about a voxel; not tuned
# Standard deviation of depth at 1 m [m], which grows with the square of the depth (as in
# `depth_view`, after Khoshelham and Elberink, Sensors 2012).
NOISE_PER_M2 = 0.003
# A measured surface contains a point if their depths differ by at most this length plus two
# standard deviations.
_SURFACE_M = 0.06


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
        height, width = self.depth_m.shape
        return height, width

    @property
    def pixel_m(self) -> float:
        """Return the distance [m] between neighboring strided pixels at a depth of 1 m."""
        return STRIDE / self._camera.model.fx_px

    def pixels_of(self, box_xyxy_px: tuple[float, ...]) -> tuple[int, int, int, int]:
        """Return left, top, right and bottom of a box in strided pixels, cut at the border."""
        height, width = self.depth_m.shape
        x1, y1, x2, y2 = box_xyxy_px
        left = min(max(math.floor(x1 / STRIDE), 0), width)
        top = min(max(math.floor(y1 / STRIDE), 0), height)
        right = min(max(math.ceil(x2 / STRIDE), left), width)
        bottom = min(max(math.ceil(y2 / STRIDE), top), height)
        return left, top, right, bottom

    def is_at_border(self, box_px: tuple[int, int, int, int]) -> bool:
        """Return whether a box in strided pixels reaches the border of the image."""
        height, width = self.depth_m.shape
        left, top, right, bottom = box_px
        return left == 0 or top == 0 or right == width or bottom == height

    def fill_screens(self, depth_m: Float32Array, detections: Sequence[DynamicObject]) -> None:
        """Give the holes in the boxes of screens the depth of the plane through their frames."""
        for item in detections:
            if item.class_name not in _SCREENS:
                continue
            left, top, right, bottom = (STRIDE * n for n in self.pixels_of(item.box_xyxy_px))
            is_hole = depth_m[top:bottom, left:right] == 0
            if is_hole.size and is_hole.mean() >= _SCREEN_HOLES:
                self._fill_holes(depth_m[top:bottom, left:right], is_hole, (left, top))

    def _fill_holes(
        self, depth_m: Float32Array, is_hole: BoolArray, corner_px: tuple[int, int]
    ) -> None:
        """Fill the holes (h, w) of one box, whose first pixel in the full image is `corner_px`."""
        near = cv2.dilate(is_hole.astype(np.uint8), _FRAME_AREA)
        v, u = np.nonzero((near > 0) & ~is_hole)
        z = depth_m[v, u].astype(np.float64)
        is_frame = _in_nearest_layer(z)
        # The inverse depth of a plane is linear in the pixel coordinates.
        rows = np.stack([u, v, np.ones(len(u))], 1)
        for _ in range(2):  # the second pass includes all of a tilted frame
            if np.count_nonzero(is_frame) < _FRAME_READINGS:
                return
            A, b = rows[is_frame], 1 / z[is_frame]
            plane = np.linalg.lstsq(A.T @ A, A.T @ b, rcond=None)[0]
            low_m, high_m = z[is_frame].min(), z[is_frame].max()
            plane_m = 1 / np.maximum(rows @ plane, 1e-6)  # a plane behind the camera fits nothing
            is_frame = np.abs(plane_m - z) < np.maximum(_FRAME_M, NOISE_PER_M2 * z * z)
        v, u = np.nonzero(is_hole[::STRIDE, ::STRIDE])
        inverse = np.stack([STRIDE * u, STRIDE * v, np.ones(len(u))], 1) @ plane
        filled = 1 / np.clip(inverse, 1 / high_m, 1 / low_m)
        index = (v + corner_px[1] // STRIDE) * self.shape[1] + u + corner_px[0] // STRIDE
        self.depth_m.reshape(-1)[index] = filled
        rays = self._camera.rays[index] * filled[:, None]
        self.points_map_m[index] = se3.transform(self.T_map_camera, rays)

    def look_at(
        self, points_camera_m: FloatArray, is_solid: BoolArray, ends: IntArray
    ) -> SeenVoxels:
        """Return which voxels of some objects the image shows, hides or sees through.

        A voxel is visible if the measured depth at its pixel differs from its own by at most 6 cm
        and two standard deviations of depth, and seen through if the measured depth is larger.
        Otherwise it is occluded, or nothing is known of it.

        Args:
            points_camera_m: (N, 3) voxels in the camera frame.
            is_solid: (N,) whether they belong to their objects.
            ends: (O,) index after the last voxel of each object.
        """
        z = points_camera_m[:, 2]
        ahead = np.flatnonzero((z > _MIN_RANGE_M) & (z < _MAX_RANGE_M))
        uv = self._camera.model.project_px(points_camera_m[ahead]) / STRIDE
        margins = _SURFACE_M, 2 * NOISE_PER_M2
        return seen_voxels(self.depth_m, ahead, uv, z, is_solid, ends, margins)


class ObjectCamera:
    """A camera with the viewing rays of every fourth pixel."""

    def __init__(self, model: CameraModel) -> None:
        self.model = model
        self.rays = pixel_rays(model, STRIDE).reshape(-1, 3)

    def view(self, depth_m: Float32Array, T_map_camera: FloatArray) -> ObjectView:
        """Return the view of a depth image (H, W) with its pose (4, 4)."""
        return ObjectView(self, depth_m, T_map_camera)


def edge_m(depth_m: Float32Array) -> Float32Array:
    """Return the depth step (h, w) [m] from which on there is an edge between two pixels."""
    return _EDGE_SLOPE * depth_m + _EDGE_NOISE * NOISE_PER_M2 * depth_m * depth_m


def _reliable(depth_m: Float32Array) -> Float32Array:
    """Return the strided depth (h, w) of a full depth image; 0 at depth edges and out of range."""
    depth = depth_m[::STRIDE, ::STRIDE]
    height, width = depth.shape
    padded = cv2.copyMakeBorder(depth_m, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    near, far = depth.copy(), depth.copy()
    for dy, dx in product(range(3), range(3)):  # the 3x3 pixels around each strided pixel
        part = padded[dy::STRIDE, dx::STRIDE][:height, :width]
        np.minimum(near, part, out=near)
        np.maximum(far, part, out=far)
    good = (far - near < edge_m(depth)) & (depth > _MIN_RANGE_M) & (depth < _MAX_RANGE_M)
    return np.ascontiguousarray(np.where(good, depth, np.float32(0)))


def _in_nearest_layer(depth_m: FloatArray) -> BoolArray:
    """Return the (N,) mask of the depths (N,) in the nearest well-filled layer."""
    if len(depth_m) == 0:
        return np.zeros(0, np.bool_)
    bins = (depth_m / _FRAME_BIN_M).astype(np.int64)
    count = np.bincount(bins, minlength=_FRAME_BINS)
    layers = np.convolve(count, np.ones(_FRAME_BINS, np.int64))[_FRAME_BINS - 1 :]
    first = int(np.argmax(layers >= _FRAME_NEARER * layers.max()))
    return np.asarray((bins >= first) & (bins < first + _FRAME_BINS))
