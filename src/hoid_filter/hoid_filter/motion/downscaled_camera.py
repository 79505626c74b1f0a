"""The low-resolution images in which motion is segmented, and their mapping to full images."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import (
    S_PER_NS,
    BoolArray,
    ByteArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_native import Pinhole, depth_segments
from hoid_native.results import Segments

# Chosen: a quarter of VGA's width suffices for depth segments; points, which are tracked to a
# tenth of a pixel, need half of it.
DEPTH_WIDTH_PX = 160
GRAY_WIDTH_PX = 320
# Corners, edge midpoints and center of a box as ratios of its sides; lens distortion bends edges.
_BOX_POINTS = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]), axis=-1).reshape(-1, 2)
# Baseline of the virtual right camera for stereo observations (decision 002); structured-light
# cameras have 7.5 cm.
_BASELINE_M = 0.075
# Chosen, 1/8 of the image: cell size of the grid that cuts segments. A static surface that touches
# a moving object is then masked with it in one cell at most.
_SEGMENT_CELL_PX = 20


class DownscaledCamera:
    """Converts full images of a camera to low resolution, and pixels and boxes back.

    The depth image is 160 px wide and undistorted; the gray image is 320 px wide and keeps the
    lens distortion. Depth is sampled, not averaged, because the mean of the depths of a person and
    a wall is the depth of neither.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self.shape_hw = _shape_hw(camera, DEPTH_WIDTH_PX)
        self.depth_pinhole = _pinhole(camera, DEPTH_WIDTH_PX)
        self.gray_pinhole = _pinhole(camera, GRAY_WIDTH_PX)
        # Disparity (px) times depth (m).
        self.disparity_px_m = self.gray_pinhole.fx_px * _BASELINE_M
        self._gray_scale = camera.width_px / GRAY_WIDTH_PX
        self._sampled = self._sample_pixels()
        # (H * W,) flat index into the low-resolution depth image for each full-resolution pixel.
        self.downscaled_of_pixel = self._downscaled_of_pixel()

    def depth(self, depth_m: Float32Array) -> Float32Array:
        """Return the low-resolution depth (h, w) of an (H, W) depth image; 0 = no measurement."""
        sampled_m = depths_at(depth_m, self._sampled)
        sampled_m[self._sampled < 0] = 0.0
        return sampled_m.reshape(self.shape_hw)

    def gray(self, image_gray: ByteArray) -> ByteArray:
        height, width = _shape_hw(self.camera, GRAY_WIDTH_PX)
        resized = cv2.resize(image_gray, (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(resized, np.uint8)

    def full_px(self, gray_px: Float32Array) -> Float32Array:
        return (gray_px + np.float32(0.5)) * np.float32(self._gray_scale) - np.float32(0.5)

    def gray_px(self, full_px: Float32Array) -> Float32Array:
        return (full_px + np.float32(0.5)) / np.float32(self._gray_scale) - np.float32(0.5)

    def measure(self, full_px: Float32Array, depth_m: FloatArray) -> FloatArray:
        """Return stereo observations (N, 3) u, v, u_right of pixels (N, 2) of the full image.

        They are in undistorted pixels of the gray image; u_right is NaN without depth.
        """
        observed_px = np.empty((len(full_px), 3))
        observed_px[:, :2] = self.gray_px(self.camera.undistort_px(full_px))
        known = depth_m > 0
        disparity_px = self.disparity_px_m / np.where(known, depth_m, 1.0)
        observed_px[:, 2] = np.where(known, observed_px[:, 0] - disparity_px, np.nan)
        return observed_px

    def points_m(self, observed_px: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Return the points (N, 3) in the camera frame of observations (N, 3); 0 without depth."""
        rays = rays_of(self.gray_pinhole, observed_px[:, 0], observed_px[:, 1])
        return rays * depth_m[:, None]

    def boxes_px(self, boxes_xywh_px: IntArray) -> FloatArray:
        """Convert boxes (N, 4) x, y, w, h in the depth image to x1, y1, x2, y2 in the full one."""
        left_top, size = boxes_xywh_px[:, None, :2], boxes_xywh_px[:, None, 2:]
        at_px = left_top + size * _BOX_POINTS - 0.5  # (N, 9, 2)
        rays = rays_of(self.depth_pinhole, at_px[..., 0].ravel(), at_px[..., 1].ravel())
        imaged_px = self.camera.project_px(rays).reshape(at_px.shape) + 0.5
        edges_px = np.concatenate([imaged_px.min(axis=1), imaged_px.max(axis=1)], axis=1)
        boxes_px: FloatArray = np.clip(edges_px, 0, (*self.camera.size_px, *self.camera.size_px))
        return boxes_px

    def _sample_pixels(self) -> IntArray:
        """Return the flat index (h * w,) into the full image of each depth pixel; -1 = outside."""
        height, width = self.shape_hw
        v, u = np.mgrid[0:height, 0:width]
        rays = rays_of(self.depth_pinhole, u.ravel(), v.ravel())
        imaged_px = self.camera.project_px(rays)
        column, row = np.rint(imaged_px).astype(np.int64).T
        full_width, full_height = self.camera.size_px
        outside = (column < 0) | (row < 0) | (column >= full_width) | (row >= full_height)
        return np.where(outside, -1, row * full_width + column)

    def _downscaled_of_pixel(self) -> IntArray:
        """Return the flat index (H * W,) into the depth image of each pixel of the full image.

        Pixels outside the depth image get an index on its border. Only one pixel per depth pixel
        is undistorted and the others are interpolated, because undistorting all takes as long as
        the time between two images.
        """
        height, width = self.shape_hw
        v, u = np.mgrid[0:height, 0:width]
        scale = DEPTH_WIDTH_PX / self.camera.width_px
        imaged_px = (np.stack([u.ravel(), v.ravel()], axis=1) + 0.5) / scale - 0.5
        ideal_px = self.camera.undistort_px(imaged_px.astype(np.float32))
        field_px = ((ideal_px + 0.5) * scale - 0.5).reshape(height, width, 2)
        all_px = cv2.resize(field_px, self.camera.size_px, interpolation=cv2.INTER_LINEAR)
        return nearest_pixels(np.asarray(all_px, np.float32).reshape(-1, 2), self.shape_hw)


def depths_at(depth_m: Float32Array, pixels: IntArray) -> Float32Array:
    """Return the (N,) depths (m) at flat pixels; 0 where the depth is not finite."""
    found_m = depth_m.take(pixels)
    found_m[~np.isfinite(found_m)] = 0.0
    return found_m


def nearest_pixels(uv_px: Float32Array, shape_hw: tuple[int, ...]) -> IntArray:
    """Return the flat indices (N,) of the pixels nearest to (N, 2), clipped to the image."""
    height, width = shape_hw
    column, row = np.rint(uv_px).astype(np.int64).T
    flat: IntArray = _clip(row, height) * width + _clip(column, width)
    return flat


def _clip(indices: IntArray, size: int) -> IntArray:
    """Return indices clipped to 0..size - 1; `np.clip` takes three times as long."""
    return np.minimum(np.maximum(indices, 0), size - 1)


def _shape_hw(camera: CameraModel, width_px: int) -> tuple[int, int]:
    return max(round(camera.height_px * width_px / camera.width_px), 1), width_px


def rays_of(pinhole: Pinhole, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
    """Return the points (N, 3) at z = 1 m on the rays of pixels (N,), (N,)."""
    rays = np.empty((len(u_px), 3))
    rays[:, 0] = (u_px - pinhole.cx_px) / pinhole.fx_px
    rays[:, 1] = (v_px - pinhole.cy_px) / pinhole.fy_px
    rays[:, 2] = 1.0
    return rays


def _pinhole(camera: CameraModel, width_px: int) -> Pinhole:
    scale = width_px / camera.width_px
    return Pinhole(
        camera.fx_px * scale,
        camera.fy_px * scale,
        (camera.cx_px + 0.5) * scale - 0.5,
        (camera.cy_px + 0.5) * scale - 0.5,
    )


class MotionView(NamedTuple):
    """A full-resolution gray and depth image with its corners, for motion segmentation."""

    stamp_ns: int
    camera: CameraModel
    image_gray: ByteArray  # (H, W)
    depth_m: Float32Array  # (H, W); 0 = no depth
    corner_pixels: IntArray  # (K,) FAST corners, as indices into the flattened image
    corner_scores: ByteArray  # (K,) strength of each corner
    # (h, w), of any resolution: dynamic objects that a detector has found in this image or in the
    # one before. None: there are none.
    detected_mask: BoolArray | None = None

    def is_detected(self, pixels: IntArray) -> BoolArray:
        """Return (N,) whether each pixel (flat index) lies on a detected dynamic object."""
        if self.detected_mask is None:
            return np.zeros(len(pixels), np.bool_)
        (height, width), (mask_height, mask_width) = self.depth_m.shape, self.detected_mask.shape
        rows = pixels // width * mask_height // height
        columns = pixels % width * mask_width // width
        flags: BoolArray = self.detected_mask[rows, columns]
        return flags


class DownscaledView(NamedTuple):
    """The low-resolution gray and depth images of a view, and its depth segments."""

    stamp_s: float
    gray: ByteArray  # about (2h, 2w), twice the resolution of the depth image
    depth_m: Float32Array  # (h, w); 0 = no depth
    segments: Segments  # S pieces of smooth depth, cut along depth edges and a grid


def downscale(view: MotionView, camera: DownscaledCamera) -> DownscaledView:
    depth_m = camera.depth(view.depth_m)
    segments = depth_segments(depth_m, _SEGMENT_CELL_PX)
    gray = camera.gray(view.image_gray)
    return DownscaledView(view.stamp_ns * S_PER_NS, gray, depth_m, segments)
