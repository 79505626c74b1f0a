"""How far a person is: the depth of the layer that fills the middle of the box."""

from __future__ import annotations

import math

import numpy as np

from hoid_common.values import Float32Array, IntArray
from hoid_filter.depth_regions import Box, crop

_BIN_M = 0.1
_FARTHEST_M = 10.0
_LAYER_BINS = 4  # a torso's thickness
_LAYER = np.ones(_LAYER_BINS, np.int64)
_NEARER_SHARE = 0.6  # of the largest layer: a nearer one that large is the person
_MIDDLE = (0.2, 0.1, 0.8, 0.9)  # part of a box that mostly shows the person: x1 y1 x2 y2
_STEP_M = 0.5  # a torso's depth changes by less from image to image
_KEPT_SHARE = 0.3  # of the readings: with fewer near the known depth, that was the background's


def torso_depth_m(
    small_depth_m: Float32Array, box_xyxy_px: Box, known_m: float = math.nan
) -> float:
    """Return the depth of a person in a box; NaN when no reading fits.

    Args:
        small_depth_m: (h, w), as `depth_regions.shrink` returns it.
        known_m: depth of the same person a moment ago, or NaN.
    """
    x1, y1, x2, y2 = box_xyxy_px
    left, top, right, bottom = _MIDDLE
    width, height = x2 - x1, y2 - y1
    middle = (x1 + left * width, y1 + top * height, x1 + right * width, y1 + bottom * height)
    readings = small_depth_m[crop(middle, small_depth_m.shape)].ravel()
    usable = (readings > 0) & (readings < _FARTHEST_M)
    readings = readings[usable]
    if not math.isnan(known_m):
        near = readings[np.abs(readings - known_m) < _STEP_M]
        readings = near if len(near) > _KEPT_SHARE * len(readings) else readings
    if len(readings) == 0:
        return math.nan
    bins = (readings / _BIN_M).astype(np.int64)
    first = _first_layer(bins)
    inside = readings[(bins >= first) & (bins < first + _LAYER_BINS)]
    middle_rank = len(inside) // 2
    return float(np.partition(inside, middle_rank)[middle_rank])


def _first_layer(bins: IntArray) -> int:
    """Return the bin where the nearest large layer of readings, given by their bins, begins."""
    count = np.bincount(bins, minlength=_LAYER_BINS)
    layers = np.convolve(count, _LAYER)[_LAYER_BINS - 1 :]
    first = int(np.argmax(layers >= _NEARER_SHARE * layers.max()))
    return first + int(np.argmax(layers[first : first + _LAYER_BINS]))
