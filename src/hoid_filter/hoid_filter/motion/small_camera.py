"""The small images in which motion is judged: of an ideal camera, and of one size for all."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import (
    ByteArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_native import Pinhole, depths_at

DEPTH_WIDTH_PX = 160
GRAY_WIDTH_PX = 320
# Corners of a box, and what lies halfway: a lens bends its edges.
_AROUND = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]), axis=-1).reshape(-1, 2)
_BASELINE_M = 0.075  # of the virtual right camera: depth as a disparity, like a depth camera's own


class SmallCamera:
    """Brings images of one camera down to small ones without distortion, and back.

    Depth is sampled, never averaged: between a person and a wall there is nothing.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self.shape_hw = _shape(camera, DEPTH_WIDTH_PX)
        self.depth_pinhole = _pinhole(camera, DEPTH_WIDTH_PX)
        self.gray_pinhole = _pinhole(camera, GRAY_WIDTH_PX)
        self.disparity_px_m = self.gray_pinhole.fx_px * _BASELINE_M
        self._gray_step = camera.width_px / GRAY_WIDTH_PX
        self._sampled = self._samples()
        self.small_of_pixel = self._small_pixels()  # (H * W,) flat

    def depth(self, depth_m: Float32Array) -> Float32Array:
        """Return the small depth image of an (H, W) one; 0 = no reading."""
        return depths_at(depth_m, self._sampled).reshape(self.shape_hw)

    def gray(self, image_gray: ByteArray) -> ByteArray:
        """Return the small (distorted) grey image in which points are followed."""
        height, width = _shape(self.camera, GRAY_WIDTH_PX)
        small = cv2.resize(image_gray, (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(small, np.uint8)

    def full_px(self, gray_px: Float32Array) -> Float32Array:
        """Return (N, 2) positions in the full image from those in the grey one."""
        return (gray_px + np.float32(0.5)) * np.float32(self._gray_step) - np.float32(0.5)

    def gray_px(self, full_px: Float32Array) -> Float32Array:
        """Return (N, 2) positions in the grey image, from those in the full one."""
        return (full_px + np.float32(0.5)) / np.float32(self._gray_step) - np.float32(0.5)

    def small_pixels(self, pixels: IntArray) -> IntArray:
        """Return the flat indices in the small depth image, (N,), of those in the full image."""
        return self.small_of_pixel[pixels]

    def measure(self, full_px: Float32Array, depth_m: FloatArray) -> FloatArray:
        """Return (N, 3) undistorted u, v, u_right at the grey image's scale; NaN: no depth."""
        out = np.empty((len(full_px), 3))
        out[:, :2] = self.gray_px(self.camera.undistort_px(full_px))
        known = depth_m > 0
        disparity_px = self.disparity_px_m / np.where(known, depth_m, 1.0)
        out[:, 2] = np.where(known, out[:, 0] - disparity_px, np.nan)
        return out

    def points_m(self, measured_px: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Return the (N, 3) points in the camera's frame that measurements show."""
        rays = _rays(self.gray_pinhole, measured_px[:, 0], measured_px[:, 1])
        return rays * depth_m[:, None]

    def boxes_px(self, boxes_xywh_px: IntArray) -> FloatArray:
        """Return the (N, 4) boxes in the full image around (N, 4) of the small depth image."""
        left_top, size = boxes_xywh_px[:, None, :2], boxes_xywh_px[:, None, 2:]
        at_px = left_top + size * _AROUND - 0.5  # (N, 9, 2)
        rays = _rays(self.depth_pinhole, at_px[..., 0].ravel(), at_px[..., 1].ravel())
        imaged_px = self.camera.project_px(rays).reshape(at_px.shape) + 0.5
        edges_px = np.concatenate([imaged_px.min(axis=1), imaged_px.max(axis=1)], axis=1)
        boxes_px: FloatArray = np.clip(edges_px, 0, (*self.camera.size_px, *self.camera.size_px))
        return boxes_px

    def _samples(self) -> IntArray:
        """Return (h * w,) flat pixels of the full image; -1 = none is there."""
        height, width = self.shape_hw
        v, u = np.mgrid[0:height, 0:width]
        rays = _rays(self.depth_pinhole, u.ravel(), v.ravel())
        imaged_px = self.camera.project_px(rays)
        column, row = np.rint(imaged_px).astype(np.int64).T
        full_width, full_height = self.camera.size_px
        outside = (column < 0) | (row < 0) | (column >= full_width) | (row >= full_height)
        return np.where(outside, -1, row * full_width + column)

    def _small_pixels(self) -> IntArray:
        """Undistort every fourth pixel: for all there is no time until the next image."""
        height, width = self.shape_hw
        v, u = np.mgrid[0:height, 0:width]
        scale = DEPTH_WIDTH_PX / self.camera.width_px
        imaged_px = (np.stack([u.ravel(), v.ravel()], axis=1) + 0.5) / scale - 0.5
        ideal_px = self.camera.undistort_px(imaged_px.astype(np.float32))
        field_px = ((ideal_px + 0.5) * scale - 0.5).reshape(height, width, 2)
        all_px = cv2.resize(field_px, self.camera.size_px, interpolation=cv2.INTER_LINEAR)
        return nearest_pixels(np.asarray(all_px, np.float32).reshape(-1, 2), self.shape_hw)


def nearest_pixels(uv_px: Float32Array, shape_hw: tuple[int, ...]) -> IntArray:
    """Return the flat indices of the pixels nearest to (N, 2) positions."""
    height, width = shape_hw
    column, row = np.rint(uv_px).astype(np.int64).T
    flat: IntArray = _within(row, height) * width + _within(column, width)
    return flat


def _within(indices: IntArray, size: int) -> IntArray:
    """Return indices in 0 to size - 1; np.clip takes three times as long."""
    return np.minimum(np.maximum(indices, 0), size - 1)


def _shape(camera: CameraModel, width_px: int) -> tuple[int, int]:
    return max(round(camera.height_px * width_px / camera.width_px), 1), width_px


def _rays(pinhole: Pinhole, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
    """Return the (N, 3) points at a depth of 1 m that pixels show."""
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
