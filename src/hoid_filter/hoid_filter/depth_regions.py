"""The depth image cut along its jumps: a person or an object is a region, or a few.

Works on depth images of a quarter of the size, as what matters is large.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray
from hoid_filter.pyramid import Int32Array

SHRINK = 4
_JUMP_M = 0.02  # a jump is more than this ...
_JUMP_SHARE = 0.03  # ... plus this share of the depth: surfaces seen at a slant must not break
_INSIDE_SHARE = 0.6  # of a region that belongs to what a box shows
_FILLED_SHARE = 0.25  # of a box: with less, what it shows has merged with what it touches
_HOLE_PX = 11  # full width, in small pixels, of the gap without readings that a region fills
_NEIGHBOURS = np.ones((3, 3), np.uint8)
_GAP = np.ones((_HOLE_PX, _HOLE_PX), np.uint8)


Box = tuple[float, float, float, float]
Area = tuple[slice, slice]


def shrink(depth_m: Float32Array) -> Float32Array:
    """Return every fourth pixel of every fourth row."""
    return np.ascontiguousarray(depth_m[SHRINK // 2 :: SHRINK, SHRINK // 2 :: SHRINK])


def crop(box_xyxy_px: Box, shape_hw: tuple[int, ...]) -> Area:
    """Return the rows and columns of a small image that a box of the full image covers."""
    height, width = shape_hw
    x1, y1, x2, y2 = (value / SHRINK for value in box_xyxy_px)
    return (
        slice(max(math.floor(y1), 0), min(max(math.ceil(y2), 0), height)),
        slice(max(math.floor(x1), 0), min(max(math.ceil(x2), 0), width)),
    )


class DepthRegions:
    """The regions of an image within which depth does not jump."""

    def __init__(self, small_depth_m: Float32Array) -> None:
        """Take a depth image as `shrink` returns it, (h, w); 0 = no reading."""
        self.depth_m = small_depth_m
        gradient_m = cv2.morphologyEx(small_depth_m, cv2.MORPH_GRADIENT, _NEIGHBOURS)
        smooth = (gradient_m < _JUMP_M + _JUMP_SHARE * small_depth_m) & (small_depth_m > 0)
        self.num, labels = cv2.connectedComponents(smooth.view(np.uint8), connectivity=4)
        self.labels: Int32Array = np.asarray(labels, np.int32)  # (h, w); 0 = no region
        flat = self.labels.ravel()
        self._sizes = np.bincount(flat, minlength=self.num)
        total_m = np.bincount(flat, weights=small_depth_m.ravel(), minlength=self.num)
        self._mean_m: FloatArray = total_m / np.maximum(self._sizes, 1)

    def shown_in(self, area: Area, depth_m: float, reach_m: float) -> BoolArray:
        """Return the (num,) regions that lie mostly in an area and within `reach_m` of a depth."""
        inside = np.bincount(self.labels[area].ravel(), minlength=self.num)
        own: BoolArray = inside >= _INSIDE_SHARE * self._sizes
        own &= np.abs(self._mean_m - depth_m) < reach_m
        own[0] = False
        return own

    def pixels_in(
        self, area: Area, own: BoolArray, depth_m: float, reach_m: float, *, sure: bool
    ) -> BoolArray:
        """Return the pixels of an area that belong to a thing: its own regions, and the gaps.

        When its regions are too little, although it is `sure` that the thing is there, it has
        merged with what it touches: then every pixel of the area within `reach_m` counts.
        """
        depth = self.depth_m[area]
        pixels: BoolArray = own[self.labels[area]]
        if sure and self._sizes[own].sum() < _FILLED_SHARE * depth.size:
            pixels |= np.abs(depth - np.float32(depth_m)) < reach_m
        beside = np.asarray(cv2.dilate(pixels.view(np.uint8), _GAP))
        pixels |= (beside > 0) & (depth <= 0)
        return pixels
