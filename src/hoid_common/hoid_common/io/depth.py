"""The range of depth measurements, and checks that depth has the right unit.

Every depth image and feature is limited to this range where it enters the suite. Outside it there
is no measurement, so that no later stage needs a range of its own for validity.
"""

from __future__ import annotations

import numpy as np

from hoid_common.errors import MessageError
from hoid_common.values import BoolArray, Float32Array

MIN_DEPTH_M = 0.05
"""Nearest depth of a reading. Chosen: depth cameras measure from 0.07 m (RealSense D405) on; the
native kernels project no nearer point."""
MAX_DEPTH_M = 100.0
"""Farthest depth of a reading. Chosen: several times the range of any depth camera."""

_MIN_BITS, _MAX_BITS = np.array([MIN_DEPTH_M, MAX_DEPTH_M], np.float32).view(np.uint32)
# Chosen: the median depth of an image is taken from every 16th row and column, if at least 50 of
# these pixels have a reading.
_UNIT_STRIDE_PX, _MIN_READINGS = 16, 50
# Median depths of images of rooms are 0.6 to 2.9 m (800 images of fr1_xyz, 400 of an office and
# fr3_walking_halfsphere). Chosen: limits beyond which a warning is given, because the unit of
# depth may be wrong.
_USUAL_MEDIAN_M = (0.3, 8.0)
_NUM_IMAGES = 10  # chosen: a third of a second of images decides whether to warn


def is_reading(depth_m: Float32Array) -> BoolArray:
    """Return where depth of any shape is a measurement; False for 0, NaN and outside the range."""
    return (depth_m >= MIN_DEPTH_M) & (depth_m <= MAX_DEPTH_M)


def readings_m(depth_m: Float32Array) -> Float32Array:
    """Return depth (H, W) in m with 0 wherever there is no measurement.

    Itself if nothing changes.
    """
    # Seen as unsigned integers, the bits of positive floats are in ascending order, followed by
    # inf, NaN and all negative numbers. Subtracting 1 makes 0 the largest number, so that it never
    # is the minimum.
    bits = depth_m.view(np.uint32)
    if bits.max(initial=0) <= _MAX_BITS and (bits - np.uint32(1)).min(
        initial=_MAX_BITS
    ) >= _MIN_BITS - np.uint32(1):
        return depth_m
    is_valid = (bits >= _MIN_BITS) & (bits <= _MAX_BITS)
    return np.where(is_valid, depth_m, np.float32(0))


def check_depth_unit(depth_m: Float32Array, unit: str) -> None:
    """Raise MessageError, ended by a remedy, if the median depth (m) is outside the valid range.

    An image with too few measurements for a median raises no error.
    """
    median_m = _median_m(depth_m)
    if median_m is not None and not MIN_DEPTH_M <= median_m <= MAX_DEPTH_M:
        raise MessageError(
            f'depth image has a median of {median_m:.4g} m, so its unit is wrong: it is {unit}'
        )


class DepthUnitWarning:
    """Warns once, with a remedy, if the median of ten depth images is unusual for a room."""

    def __init__(self, remedy: str) -> None:
        self._remedy = remedy
        self._medians_m: list[float] = []

    def warning_for(self, depth_m: Float32Array) -> str:
        """Store the median of depth (H, W) in m; return a warning at the tenth, else ''.

        Images with few measurements do not count.
        """
        if len(self._medians_m) >= _NUM_IMAGES or (median_m := _median_m(depth_m)) is None:
            return ''
        self._medians_m.append(median_m)
        typical_m, (least_m, most_m) = float(np.median(self._medians_m)), _USUAL_MEDIAN_M
        if len(self._medians_m) < _NUM_IMAGES or least_m <= typical_m <= most_m:
            return ''
        return (
            f'the first depth images have a median of {typical_m:.2f} m, but rooms have '
            f'{least_m:g} to {most_m:g} m: if the unit is wrong, {self._remedy}'
        )


def _median_m(depth_m: Float32Array) -> float | None:
    """Return the median of a sample of the positive, finite values; None if there are too few."""
    sample = depth_m[::_UNIT_STRIDE_PX, ::_UNIT_STRIDE_PX]
    readings = sample[(sample > 0) & (sample < np.inf)]
    return float(np.median(readings)) if len(readings) >= _MIN_READINGS else None
