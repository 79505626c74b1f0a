"""Calibration of a gyro by the tracked rotation: time offset, mounting and bias."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S, S_PER_NS, BoolArray, FloatArray, IntArray
from rgbd_slam.inertial.rotations import cauchy_weights, nearest_rotation, rotation_vector
from rgbd_slam.inertial.sample_buffer import GAP_NS, SampleBuffer
from rgbd_slam.inertial.tracked_motion import TrackedMotion

MAX_OFFSET_S = 0.1  # chosen: more than the offset of any camera with an IMU
# Chosen: step (s), and number of steps to each side, of the search for the time offset: among all
# offsets, and near the last result.
_COARSE, _FINE = (0.01, 10), (0.0025, 2)
_WINDOW_NS = 20 * NS_PER_S  # chosen: tracked rotations of this duration are compared with the gyro
_MAX_STEP_NS = NS_PER_S // 5  # chosen: longer steps between tracked images are not compared
_MIN_STEPS = 20  # chosen: fewer tracked rotations determine no calibration
# Chosen: numbers of fine searches, each with the weights from the previous one.
_ROUNDS, _NEAR_ROUNDS = 3, 2
_CAUCHY = 1.5  # chosen: residuals of this multiple of the median get half the weight
_LEAST_RAD = 1e-4  # chosen: far below the errors of tracked rotations, so that no weight is 0 / 0
_LEAST_WEIGHT = 0.12  # chosen: residuals above four times the median are not used for the bias
# Chosen: number of steps in half a second, in which tracking errors are correlated.
_BLOCK_STEPS = 15
# Chosen: least standard deviation of an estimated bias, and standard deviation of a bias that is
# not estimated yet. 0.02 rad/s is the zero-rate error of common MEMS gyros at room temperature
# (Bosch BMI055: 1 deg/s).
_MIN_BIAS_RADPS, UNKNOWN_BIAS_RADPS = 5e-4, 0.02
# Chosen: axes count as mirrored only if the sum of squared rotations about the axis that turns
# least is at least this ratio of that about the axis that turns most. Otherwise noise would decide
# the sign of that axis.
_MIRROR_SHARE = 0.1
_MIN_ROTATION_RAD, _MIN_OFFSET_S = np.deg2rad(0.1), 5e-4


class GyroFit(NamedTuple):
    """The calibration of a gyro from the tracked rotations of the last 20 s.

    Tracked rotation vectors are w_camera = R_camera_imu @ (w_imu - bias * time), where w_imu is
    measured by the gyro and `offset_s` later by stamp.
    """

    offset_s: float  # the stamps of the IMU are later than those of the images by this time
    R_camera_imu: FloatArray  # (3, 3)
    bias_radps: FloatArray  # (3,) along the axes of the IMU
    offset_sigma_s: float  # standard deviation of the offset
    rotation_sigma_rad: float  # largest standard deviation about any axis
    bias_sigma_radps: float
    residual_radps: float  # RMS of the differences between measured and tracked rates
    signal_radps: float  # RMS of the tracked rates, with their mean subtracted
    scale: float  # factor on the measured rates that fits the tracked ones best
    # Correlation of measured and tracked rates: 1 for a perfect gyro of any scale.
    correlation: float
    is_mirrored: bool  # whether the rates fit much better if an axis is reflected

    @property
    def text(self) -> str:
        turn = ', '.join(f'{v:.1f}' for v in np.rad2deg(rotation_vector(self.R_camera_imu)))
        bias = ', '.join(f'{value:.4f}' for value in self.bias_radps)
        return (
            f'imu: its stamps are {1e3 * self.offset_s:.0f} ms later than those of the images, '
            f'its rotation to the camera is ({turn}) degrees, its bias ({bias}) rad/s'
        )


def fit_gyro(
    motion: TrackedMotion,
    gyro: SampleBuffer,
    R_camera_imu: FloatArray | None = None,
    near_s: float | None = None,
    window_ns: int = _WINDOW_NS,
) -> GyroFit | None:
    """Return the calibration of a gyro from tracked rotations; None if there are too few.

    The rotation is that of Kabsch (1976), the bias is the mean difference of the rates, and the
    offset minimizes the squared residuals.

    Args:
        R_camera_imu: (3, 3) the rotation, if it is known; None: estimate it.
        near_s: The offset (`GyroFit.offset_s`) if known to 10 ms; None: try all offsets.
        window_ns: Duration of the latest rotations that are compared.
    """
    steps = _tracked_steps(motion, gyro, window_ns)
    if steps is None:
        return None
    searches = [_COARSE] + _ROUNDS * [_FINE] if near_s is None else _NEAR_ROUNDS * [_FINE]
    offset_s, curvature = near_s or 0.0, 0.0
    for step_s, count in searches:
        near_s = float(np.clip(offset_s, -MAX_OFFSET_S, MAX_OFFSET_S))
        tried_s = np.linspace(near_s - count * step_s, near_s + count * step_s, 2 * count + 1)
        offset_s, curvature = _best_offset(steps, tried_s, R_camera_imu)
        steps = steps.weighted(_aligned(steps, offset_s, R_camera_imu).residuals_rad)
    return _fit(steps, offset_s, curvature, R_camera_imu)


def _tracked_steps(motion: TrackedMotion, gyro: SampleBuffer, window_ns: int) -> _Steps | None:
    """Return the latest tracked rotations, and gyro samples that cover them at every offset."""
    newest_ns = gyro.newest_ns
    if newest_ns is None or motion.newest_ns is None:
        return None
    first_ns, second_ns, R = motion.steps(motion.newest_ns - window_ns, _MAX_STEP_NS)
    if len(first_ns) < _MIN_STEPS:
        return None
    margin_ns = round((MAX_OFFSET_S + _COARSE[0]) * NS_PER_S)
    low_ns, high_ns = first_ns - margin_ns, second_ns + margin_ns
    stamps_ns, rates_radps = gyro.between(int(low_ns[0]), int(high_ns[-1]))
    is_covered = _are_covered(stamps_ns, low_ns, high_ns)
    if np.count_nonzero(is_covered) < _MIN_STEPS:
        return None
    known_s = S_PER_NS * (stamps_ns - first_ns[0])
    turns_rad = 0.5 * (rates_radps[1:] + rates_radps[:-1]) * np.diff(known_s)[:, None]
    return _Steps(
        S_PER_NS * (first_ns - first_ns[0])[is_covered],
        S_PER_NS * (second_ns - first_ns[0])[is_covered],
        rotation_vector(R[is_covered]),
        np.ones(np.count_nonzero(is_covered)),
        known_s,
        np.vstack([np.zeros((1, 3)), np.cumsum(turns_rad, axis=0)]),
    )


def _are_covered(stamps_ns: IntArray, low_ns: IntArray, high_ns: IntArray) -> BoolArray:
    """Return (M,) whether samples (N,) cover each interval from low to high without a gap."""
    if not len(stamps_ns):
        return np.zeros(len(low_ns), np.bool_)
    num_gaps = np.append(0, np.cumsum(np.diff(stamps_ns) > GAP_NS))
    low, high = np.searchsorted(stamps_ns, np.stack([low_ns, high_ns]))
    before = num_gaps[np.maximum(low - 1, 0)]
    after = num_gaps[np.minimum(high, len(stamps_ns) - 1)]
    is_within = (low_ns >= stamps_ns[0]) & (high_ns <= stamps_ns[-1])
    return np.asarray(is_within & (before == after))


class _Steps(NamedTuple):
    """M tracked rotations, each from an image to the next one, and N gyro samples, integrated."""

    first_s: FloatArray  # (M,) stamps of the first images, since the first one of all
    second_s: FloatArray  # (M,) stamps of the second images
    tracked_rad: FloatArray  # (M, 3) rotation vectors in the camera frame
    weight: FloatArray  # (M,) from 0 to 1; small for tracked rotations with large residuals
    known_s: FloatArray  # (N,) stamps of the samples
    sums_rad: FloatArray  # (N, 3) integrals of the rates up to each sample, in the IMU frame

    @property
    def time_s(self) -> FloatArray:
        return self.second_s - self.first_s

    def measured_rad(self, offset_s: float) -> FloatArray:
        """Return the integrals (M, 3) of the rates in rad at an offset; rotations are summed."""
        ends_s = np.concatenate([self.first_s, self.second_s]) + offset_s
        ends = [np.interp(ends_s, self.known_s, column) for column in self.sums_rad.T]
        first, second = np.split(np.stack(ends, axis=1), 2)
        return np.asarray(second - first)

    def weighted(self, residuals_rad: FloatArray) -> _Steps:
        """Return the steps with weights by a Cauchy kernel for the residuals (M,)."""
        return self._replace(weight=cauchy_weights(residuals_rad, _CAUCHY, _LEAST_RAD))


class _Alignment(NamedTuple):
    """Tracked and measured rotations at one time offset, with their mean rates subtracted."""

    R_camera_imu: FloatArray  # (3, 3)
    tracked_rad: FloatArray  # (M, 3) in the camera frame
    measured_rad: FloatArray  # (M, 3) in the IMU frame
    mean_measured_radps: FloatArray  # (3,)
    mean_tracked_radps: FloatArray  # (3,)

    @property
    def difference_rad(self) -> FloatArray:
        """Return tracked minus measured rotations (M, 3) in rad, in the camera frame."""
        return self.tracked_rad - self.measured_rad @ self.R_camera_imu.T

    @property
    def residuals_rad(self) -> FloatArray:
        """Return the lengths (M,) of the rotation differences in rad."""
        return np.asarray(np.linalg.norm(self.difference_rad, axis=1))


def _aligned(steps: _Steps, offset_s: float, R_camera_imu: FloatArray | None) -> _Alignment:
    time_s, weight = steps.time_s[:, None], steps.weight[:, None]
    measured = steps.measured_rad(offset_s)
    tracked, total_s = steps.tracked_rad, (weight * time_s).sum()
    mean_measured = (weight * measured).sum(axis=0) / total_s
    mean_tracked = (weight * tracked).sum(axis=0) / total_s
    tracked, measured = tracked - time_s * mean_tracked, measured - time_s * mean_measured
    if R_camera_imu is None:
        R_camera_imu = nearest_rotation((weight * tracked).T @ measured)
    return _Alignment(R_camera_imu, tracked, measured, mean_measured, mean_tracked)


def _best_offset(
    steps: _Steps, tried_s: FloatArray, R_camera_imu: FloatArray | None
) -> tuple[float, float]:
    """Return the offset (s) of least cost, interpolated by a parabola with this curvature."""
    aligned = (_aligned(steps, offset_s, R_camera_imu) for offset_s in tried_s.tolist())
    cost = np.array([steps.weight @ np.square(item.residuals_rad) for item in aligned])
    best, step_s = int(np.clip(np.argmin(cost), 1, len(cost) - 2)), float(tried_s[1] - tried_s[0])
    left, middle, right = cost[best - 1 : best + 2].tolist()
    curvature = max((left - 2 * middle + right) / step_s**2, 1e-12)
    shift_s = float(np.clip((left - right) / (2 * step_s) / curvature, -step_s, step_s))
    return float(tried_s[best]) + shift_s, curvature


def _fit(steps: _Steps, offset_s: float, curvature: float, R_known: FloatArray | None) -> GyroFit:
    """Return the fit at an offset; the bias has a prior of 0 with `UNKNOWN_BIAS_RADPS`."""
    aligned, weight = _aligned(steps, offset_s, R_known), steps.weight
    w, R = aligned.measured_rad, aligned.R_camera_imu
    H = (weight[:, None] * aligned.tracked_rad).T @ w
    power = float(weight @ np.square(w).sum(axis=1))
    tracked_power = float(weight @ np.square(aligned.tracked_rad).sum(axis=1))
    common = float(np.trace(R.T @ H))
    information = power * np.eye(3) - (weight[:, None] * w).T @ w
    variance = float(weight @ np.square(aligned.residuals_rad)) / (3 * weight.sum())
    mean_s = float(steps.time_s.mean())
    mean_radps, bias_sigma = _mean_difference(steps, aligned)
    bias_weight = 1 / (1 + (bias_sigma / UNKNOWN_BIAS_RADPS) ** 2)
    bias = aligned.mean_measured_radps - R.T @ (aligned.mean_tracked_radps + mean_radps)
    singular = np.linalg.svd(H, compute_uv=False)
    turn_rad2 = max(float(np.linalg.eigvalsh(information)[0]), _LEAST_RAD**2)
    return GyroFit(
        offset_s,
        R,
        bias_weight * bias,
        max(float(np.sqrt(2 * variance / curvature)), _MIN_OFFSET_S),
        max(float(np.sqrt(variance / turn_rad2)), _MIN_ROTATION_RAD),
        max(float(bias_sigma * np.sqrt(bias_weight)), _MIN_BIAS_RADPS),
        float(np.sqrt(3 * variance)) / mean_s,
        float(np.sqrt(np.square(aligned.tracked_rad).sum(axis=1).mean())) / mean_s,
        common / max(power, _LEAST_RAD**2),
        common / np.sqrt(max(power, _LEAST_RAD**2) * max(tracked_power, _LEAST_RAD**2)),
        bool(np.linalg.det(H) < 0 and singular[2] > _MIRROR_SHARE * singular[0]),
    )


def _mean_difference(steps: _Steps, aligned: _Alignment) -> tuple[FloatArray, float]:
    """Return the mean (3,) of tracked minus measured rates (rad/s), and its standard deviation.

    Each step has the weight 0 or 1 here, so that noise of a pose cancels out: the pose ends one
    step and begins the next. The standard deviation follows from the scatter of means over half a
    second, in which the drift of the tracked rotation does not cancel out.
    """
    is_used = steps.weight > _LEAST_WEIGHT
    starts = np.arange(0, len(is_used), _BLOCK_STEPS)
    sums_rad = np.add.reduceat(is_used[:, None] * aligned.difference_rad, starts)
    times_s = np.add.reduceat(is_used * steps.time_s, starts)
    mean_radps = sums_rad.sum(axis=0) / times_s.sum()
    deviation_rad = sums_rad - times_s[:, None] * mean_radps
    return mean_radps, float(np.sqrt(np.square(deviation_rad).sum() / 3)) / float(times_s.sum())
