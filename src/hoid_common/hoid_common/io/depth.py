"""The depth range that the whole suite accepts, and checks that depth has the right unit."""

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
# Chosen: the median depth of an image is that of every 16th row and column, if at least 50 of
# these pixels have depth.
_UNIT_STRIDE_PX, _MIN_READINGS = 16, 50
# Median depths of images of rooms are 0.6 to 2.9 m (800 images of fr1_xyz, 400 of an office and
# fr3_walking_halfsphere). Chosen: outside these limits, a warning says that the unit of depth may
# be wrong.
_USUAL_MEDIAN_M = (0.3, 8.0)
# Depth noise divided by the square of depth (1/m) is 0.00077 and 0.00081 (Kinect), 0.00045 and
# 0.0006 (D435), 0.00035 (phone), and the nearest depths are 0.48 to 1.46 m. With depth that is
# five times too large or too small, the noise would be 0.00016 or 0.0018. Chosen: limits half way
# to these, as ratios.
_NOISE_PER_M, _USUAL_NOISE_PER_M = 0.0006, (0.00024, 0.0012)
_USUAL_NEAREST_M = (0.35, 2.5)
_LEAST_NOISE_PER_M = 1e-6  # lower limit: rendered depth has no noise, and the logarithm is taken
# Ratio of the standard deviation to the median absolute value of normally distributed numbers.
_DEVIATION_PER_MEDIAN = 1.4826
_SCALES = (0.1, 0.2, 5.0, 10.0)  # ratios between the units in use: 0.1 mm, 0.2 mm (TUM) and 1 mm
_NUM_IMAGES = 10  # chosen: a third of a second of images decides whether to warn


def is_reading(depth_m: Float32Array) -> BoolArray:
    """Return where depth is a measurement; False for 0, NaN and outside the range."""
    return (depth_m >= MIN_DEPTH_M) & (depth_m <= MAX_DEPTH_M)


def readings_m(depth_m: Float32Array) -> Float32Array:
    """Return depth (H, W) in m with invalid values set to 0; the input itself if all are valid."""
    # Read as unsigned integers, the bits of positive floats are in ascending order, followed by
    # inf, NaN and all negative numbers. Subtracting 1 turns 0 into the largest number, so that it
    # is never the minimum.
    bits = depth_m.view(np.uint32)
    if bits.max(initial=0) <= _MAX_BITS and (bits - np.uint32(1)).min(
        initial=_MAX_BITS
    ) >= _MIN_BITS - np.uint32(1):
        return depth_m
    is_valid = (bits >= _MIN_BITS) & (bits <= _MAX_BITS)
    return np.where(is_valid, depth_m, np.float32(0))


def check_depth_unit(depth_m: Float32Array, unit: str) -> None:
    """Raise MessageError if the median depth (m) is out of range; `unit` ends its text."""
    median_m = _median_m(depth_m)
    if median_m is not None and not MIN_DEPTH_M <= median_m <= MAX_DEPTH_M:
        raise MessageError(
            f'depth image has a median of {median_m:.4g} m, so its unit is wrong: it is {unit}'
        )


class DepthUnitWarning:
    """Warns once, with a remedy, if the first ten depth images suggest that their unit is wrong.

    The check uses the median depth, the nearest depth, and the noise, which grows with the square
    of depth in stereo and structured-light cameras.
    """

    def __init__(self, remedy: str) -> None:
        self._remedy = remedy
        self._seen: list[tuple[float, float, float]] = []  # median, nearest depth, noise by image

    def warning_for(self, depth_m: Float32Array) -> str:
        """Store median, nearest depth and noise of (H, W) depth in m; return a warning or ''."""
        if len(self._seen) >= _NUM_IMAGES or (median_m := _median_m(depth_m)) is None:
            return ''
        self._seen.append((median_m, *_nearest_and_noise(depth_m)))
        if len(self._seen) < _NUM_IMAGES:
            return ''
        typical_m, nearest_m, noise_per_m = np.median(self._seen, axis=0).tolist()
        least_m, most_m = _USUAL_MEDIAN_M
        is_near = nearest_m < _USUAL_NEAREST_M[0] and noise_per_m > _USUAL_NOISE_PER_M[1]
        is_far = nearest_m > _USUAL_NEAREST_M[1] and noise_per_m < _USUAL_NOISE_PER_M[0]
        if least_m <= typical_m <= most_m and not is_near and not is_far:
            return ''
        likely = ''
        if is_near or is_far:
            scale = min(_SCALES, key=lambda s: abs(np.log(noise_per_m / s / _NOISE_PER_M)))
            change = f'divided by {scale:g}' if scale > 1 else f'multiplied by {1 / scale:g}'
            likely = (
                f'; the nearest depth, {nearest_m:.2f} m, and the noise, '
                f'{1e3 * noise_per_m:.2f} mm at 1 m, fit if the depth units per meter are {change}'
            )
        return (
            f'the first depth images have a median of {typical_m:.2f} m, and rooms usually '
            f'{least_m:g} to {most_m:g} m{likely}: if the unit is wrong, {self._remedy}'
        )


def _nearest_and_noise(depth_m: Float32Array) -> tuple[float, float]:
    """Return the nearest depth (1st percentile, m) of depth (H, W), and noise / depth^2 (1/m).

    The noise is computed from third differences along rows, in which smooth surfaces cancel out.
    """
    z = depth_m[::_UNIT_STRIDE_PX].astype(np.float64)
    four = np.stack([z[:, n : z.shape[1] - 3 + n] for n in range(4)])
    four = four[:, (four > 0).all(axis=0) & np.isfinite(four).all(axis=0)]
    readings = z[(z > 0) & np.isfinite(z)]
    if four.shape[1] == 0:
        return float(np.percentile(readings, 1)), _NOISE_PER_M
    third_m = np.abs(four[3] - 3 * four[2] + 3 * four[1] - four[0]) / np.sqrt(20)
    noise_per_m = _DEVIATION_PER_MEDIAN * np.median(third_m / four[1] ** 2)
    return float(np.percentile(readings, 1)), max(float(noise_per_m), _LEAST_NOISE_PER_M)


def _median_m(depth_m: Float32Array) -> float | None:
    sample = depth_m[::_UNIT_STRIDE_PX, ::_UNIT_STRIDE_PX]
    readings = sample[(sample > 0) & (sample < np.inf)]
    return float(np.median(readings)) if len(readings) >= _MIN_READINGS else None
