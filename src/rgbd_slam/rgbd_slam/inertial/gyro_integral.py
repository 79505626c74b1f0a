"""Rotations from the rates of a gyro."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, S_PER_NS, BoolArray, FloatArray, IntArray
from rgbd_slam.inertial.sample_buffer import GAP_NS, SampleBuffer, Samples

# Chosen: for this long after the newest sample its rate is held. A sample may arrive after the
# image that it belongs to.
_HELD_NS = NS_PER_S // 40
_SUMMED_S = 0.04  # chosen: one step between images at 30 Hz
_LEAST_RAD = 1e-12  # chosen: a smaller angle is zero, and keeps the quotients finite


def rotation_between(
    gyro: Samples, first_ns: int, second_ns: int, bias_radps: FloatArray
) -> FloatArray | None:
    """Return the rotation R_first_second (3, 3) of the IMU between two times by its clock.

    The rate is linear between samples. Within steps of 0.04 s the rates are summed: this causes an
    error below 1e-4 rad up to 3 rad/s. None is returned if the samples begin after `first_ns`, end
    more than 25 ms before `second_ns` or leave a gap of more than 50 ms, and if `second_ns` is
    before `first_ns`.

    Args:
        gyro: The samples around this time; see `SampleBuffer.between`.
        first_ns: Time at which the rotation begins.
        second_ns: Time at which it ends.
        bias_radps: (3,) bias of the gyro, along the axes of the IMU.
    """
    stamps_ns, rates_radps = gyro
    if second_ns <= first_ns:
        return np.eye(3) if second_ns == first_ns else None
    if not len(stamps_ns) or stamps_ns[0] > first_ns or second_ns > stamps_ns[-1] + _HELD_NS:
        return None
    if len(stamps_ns) > 1 and np.diff(stamps_ns).max() > GAP_NS:
        return None
    known_s = _seconds(stamps_ns - first_ns)
    knots_s = np.concatenate(
        [
            [0.0],
            known_s[(known_s > 0.0) & (stamps_ns < second_ns)],
            [S_PER_NS * (second_ns - first_ns)],
        ]
    )
    at_knots = interpolated(knots_s, known_s, rates_radps) - bias_radps
    steps = 0.5 * (at_knots[1:] + at_knots[:-1]) * (knots_s[1:] - knots_s[:-1])[:, None]
    _, starts = np.unique(knots_s[:-1] // _SUMMED_S, return_index=True)
    return product(rotations(np.add.reduceat(steps, starts)))


def rotations(vectors_rad: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) of rotation vectors (N, 3), by Rodrigues' formula."""
    angle = np.maximum(np.sqrt(np.vecdot(vectors_rad, vectors_rad)), _LEAST_RAD)[:, None, None]
    W = se3.hat(vectors_rad)
    half = np.sin(0.5 * angle) / angle
    return np.asarray(np.eye(3) + np.sin(angle) / angle * W + 2.0 * half**2 * (W @ W))


def rotation_vector(R: FloatArray) -> FloatArray:
    """Return the rotation vectors (..., 3) [rad] of rotations (..., 3, 3)."""
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., 3, 3] = R, 1.0
    return se3.log(T)[..., :3]


def product(R: FloatArray) -> FloatArray:
    """Return the product (3, 3) of N rotations (N, 3, 3), the first one on the left."""
    while len(R) > 1:
        if len(R) % 2:
            R = np.concatenate([R, np.eye(3)[None]])
        R = R[0::2] @ R[1::2]
    return np.asarray(R[0])


def interpolated(times_s: FloatArray, known_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return vectors (M, 3) at times (M,) by linear interpolation of vectors (N, 3).

    Before the first and after the last of the times `known_s` (N,), the nearest vector is
    returned.
    """
    return np.stack([np.interp(times_s, known_s, column) for column in values.T], axis=1)


class RateIntegral:
    """Integrates the rates of a gyro over any number of short windows at once.

    Args:
        gyro: The samples.
        first_ns: Start of the time that is needed.
        second_ns: End of this time.
    """

    def __init__(self, gyro: SampleBuffer, first_ns: int, second_ns: int) -> None:
        stamps_ns, rates_radps = gyro.between(first_ns, second_ns)
        self._origin_ns = first_ns
        self._times_s = _seconds(stamps_ns - first_ns)
        mean_radps = 0.5 * (rates_radps[1:] + rates_radps[:-1])
        steps = mean_radps * np.diff(self._times_s)[:, None]
        self._sums_rad = np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        self._num_gaps = np.append(0, np.cumsum(np.diff(stamps_ns) > GAP_NS))

    def over(self, first_ns: IntArray, second_ns: IntArray, offset_s: float) -> FloatArray:
        """Return the (M, 3) integrals [rad] over windows that start and end later by an offset.

        Rates outside the samples count as zero; `covers` tests for this. There must be at least
        one sample.
        """
        times_s = _seconds(np.stack([first_ns, second_ns]) - self._origin_ns) + offset_s
        ends = interpolated(times_s.ravel(), self._times_s, self._sums_rad)
        return ends[len(first_ns) :] - ends[: len(first_ns)]

    def covers(self, first_ns: IntArray, second_ns: IntArray, margin_s: float) -> BoolArray:
        """Return the (M,) mask of the windows that samples cover without a gap.

        Args:
            first_ns: (M,) starts of the windows.
            second_ns: (M,) ends of the windows.
            margin_s: Largest offset by which the windows will be shifted.
        """
        if len(self._times_s) < 2:  # one sample covers no time
            return np.zeros(len(first_ns), np.bool_)
        low_s = _seconds(first_ns - self._origin_ns) - margin_s
        high_s = _seconds(second_ns - self._origin_ns) + margin_s
        is_within = (low_s >= self._times_s[0]) & (high_s <= self._times_s[-1])
        low, high = np.searchsorted(self._times_s, np.stack([low_s, high_s]))
        last = len(self._num_gaps) - 1
        before = self._num_gaps[np.clip(low - 1, 0, last)]
        after = self._num_gaps[np.minimum(high, last)]
        return np.asarray(is_within & (before == after))


def _seconds(elapsed_ns: IntArray) -> FloatArray:
    return np.asarray(S_PER_NS * elapsed_ns, np.float64)
