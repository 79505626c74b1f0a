"""Consistency of published covariances with errors, by normalized estimation errors squared.

The mean of e' P^-1 e over the degrees of freedom is 1 where P is the covariance of the error e
(Bar-Shalom, Li and Kirubarajan 2001, 5.4). The reference trajectory has errors too, which are
estimated from the smoothness of its poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S, S_PER_NS, BoolArray, FloatArray, IntArray, Trajectory
from rgbd_slam.tracking.pose_noise import WINDOW, smoothness_residuals

INTERVAL_S = 1.0
# Largest deviation from INTERVAL_S, equal to the association limit of the ATE.
_ASSOCIATION_S = 0.02
_LONGEST_GAP_S = 0.05  # chosen: the reference is not interpolated across longer gaps
_CLOCKS_S = np.arange(-50, 51, 2) / 1e3  # chosen: candidate offsets of the reference's clock
_MIN_PAIRS = 10  # chosen


@dataclass(frozen=True, eq=False)
class Estimates:
    """Published poses and velocities of the camera with their covariances."""

    stamps_ns: IntArray  # (N,)
    T_odom_camera: FloatArray  # (N, 4, 4)
    covariance: FloatArray  # (N, 6, 6) in the camera frame, rotation first
    twist: FloatArray  # (N, 6) mean since the last pose, in the camera frame: rad/s, then m/s
    twist_covariance: FloatArray  # (N, 6, 6)


@dataclass(frozen=True)
class Consistency:
    """Normalized errors squared (1 = consistent, more = overconfident), errors and sigmas."""

    pose: float  # of the relative motion over one second
    twist: float  # of the mean velocity between successive poses
    error_m: float  # RMS error of the relative motion over one second
    error_deg: float
    sigma_m: float  # RMS expected from the published covariance
    sigma_deg: float


@dataclass(frozen=True, eq=False)
class ReferenceNoise:
    """Errors of the reference itself.

    If the two clock offsets differ, no single offset aligns the reference with the camera.
    """

    covariance: FloatArray  # (6, 6) of one pose, rotation first, from smoothness residuals
    rotation_clock_s: float  # offset of its stamps at which the rotations agree best
    translation_clock_s: float  # offset of its stamps at which the translations agree best


def consistency(
    estimates: Estimates, truth: Trajectory, noise: ReferenceNoise | None = None
) -> Consistency:
    """Return how well the published covariances explain the errors.

    Args:
        estimates: Published poses and covariances.
        truth: The reference trajectory.
        noise: Errors of the reference; their covariance is added to the published one.

    Raises:
        InputError: Estimate and reference overlap by less than a second.
    """
    own = np.zeros((6, 6)) if noise is None else noise.covariance
    true, is_known = _at(truth, estimates.stamps_ns, 0.0)
    first, second = _pairs(estimates.stamps_ns, is_known)
    pose = _Motion.between(true, first, second)
    error = pose.error(estimates, first, second)
    claimed = pose.covariance(estimates.covariance[first], estimates.covariance[second])
    k = 1 + np.flatnonzero(is_known[1:] & is_known[:-1])
    elapsed_s = S_PER_NS * np.diff(estimates.stamps_ns)[k - 1]
    step = _Motion.between(true, k - 1, k)
    twist_error = estimates.twist[k] - se3.log(step.T) / elapsed_s[:, None]
    twist_own = step.covariance(own, own) / elapsed_s[:, None, None] ** 2
    return Consistency(
        _normalized(error, claimed + pose.covariance(own, own)),
        _normalized(twist_error, estimates.twist_covariance[k] + twist_own),
        error_m=_rms(error[:, 3:]),
        error_deg=float(np.degrees(_rms(error[:, :3]))),
        sigma_m=_sigma(claimed[:, 3:, 3:]),
        sigma_deg=float(np.degrees(_sigma(claimed[:, :3, :3]))),
    )


def reference_noise(estimates: Estimates, truth: Trajectory) -> ReferenceNoise:
    """Return the pose noise of a reference, and its clock offsets from the camera.

    Raises:
        InputError: Estimate and reference overlap by less than a second.
    """
    rows = np.arange(len(truth) - WINDOW + 1)[:, None] + np.arange(WINDOW)
    jitter = smoothness_residuals(truth.stamps_ns[rows], truth.T_world_camera[rows])
    apart = []
    for clock_s in _CLOCKS_S.tolist():
        true, is_known = _at(truth, estimates.stamps_ns, clock_s)
        first, second = _pairs(estimates.stamps_ns, is_known)
        error = _Motion.between(true, first, second).error(estimates, first, second)
        apart.append((_rms(error[:, :3]), _rms(error[:, 3:])))
    rotation, translation = np.argmin(apart, axis=0)
    return ReferenceNoise(
        jitter.T @ jitter / len(jitter), float(_CLOCKS_S[rotation]), float(_CLOCKS_S[translation])
    )


@dataclass(frozen=True, eq=False)
class _Motion:
    """True motions between pairs of poses."""

    T: FloatArray  # (M, 4, 4) T_first_second

    @classmethod
    def between(cls, true: FloatArray, first: IntArray, second: IntArray) -> _Motion:
        return cls(se3.inverse(true[first]) @ true[second])

    def error(self, estimates: Estimates, first: IntArray, second: IntArray) -> FloatArray:
        """Return the (M, 6) errors of the estimated motions in the second frame."""
        T = estimates.T_odom_camera
        return se3.log(se3.inverse(self.T) @ se3.inverse(T[first]) @ T[second])

    def covariance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the (M, 6, 6) covariances of the motions from those of their two poses."""
        A = np.array([se3.adjoint(T) for T in se3.inverse(self.T)])
        return np.asarray(second + A @ first @ A.transpose(0, 2, 1))


def _at(truth: Trajectory, stamps_ns: IntArray, clock_s: float) -> tuple[FloatArray, BoolArray]:
    """Return interpolated reference poses (N, 4, 4), and the (N,) mask of valid poses."""
    at_ns = stamps_ns + round(clock_s * NS_PER_S)
    known_ns, T = truth.stamps_ns, truth.T_world_camera
    after = np.clip(np.searchsorted(known_ns, at_ns), 1, len(known_ns) - 1)
    gap_ns = known_ns[after] - known_ns[after - 1]
    share = (at_ns - known_ns[after - 1]) / np.maximum(gap_ns, 1)
    steps = se3.log(se3.inverse(T[after - 1]) @ T[after])
    is_known = (share >= 0) & (share <= 1) & (gap_ns <= _LONGEST_GAP_S * NS_PER_S)
    return T[after - 1] @ se3.exp(share[:, None] * steps), is_known


def _pairs(stamps_ns: IntArray, is_known: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the indices (M,), (M,) of poses a second apart with a valid reference."""
    target_ns = stamps_ns + round((INTERVAL_S - _ASSOCIATION_S) * NS_PER_S)
    second = np.searchsorted(stamps_ns, target_ns)
    found = second < len(stamps_ns)
    first, second = np.flatnonzero(found), second[found]
    late_s = S_PER_NS * (stamps_ns[second] - stamps_ns[first]) - INTERVAL_S
    keep = (np.abs(late_s) <= _ASSOCIATION_S) & is_known[first] & is_known[second]
    if np.count_nonzero(keep) < _MIN_PAIRS:
        raise InputError('estimate and ground truth overlap by less than a second')
    return first[keep], second[keep]


def _normalized(error: FloatArray, covariance: FloatArray) -> float:
    weighed = np.linalg.solve(covariance, error[..., None])[..., 0]
    return float(np.einsum('ni,ni->n', error, weighed).mean() / error.shape[1])


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=-1))))


def _sigma(covariance: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))
