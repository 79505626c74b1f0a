"""The noise of estimated poses that residuals do not show (decision 032).

An error that all matches of an image share changes the pose without residuals. But cameras move
smoothly, so that a parabola fits five successive poses. The deviation of the middle pose from the
parabola through the other four measures the pose error.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray, IntArray

# Number of poses before and after the middle one. Not tuned, nor are the numbers below (decision
# 032 has the resulting errors).
_HALF_WINDOW = 2
WINDOW = 2 * _HALF_WINDOW + 1
_DEGREE = 2  # degree of the polynomial in time: constant acceleration
_MAX_WINDOW_S = 0.3  # longest window; a hand-held camera hardly keeps its acceleration for longer
_PRIOR_SAMPLES = 5  # weight of the residual-based covariance, as a number of samples
_MAX_SAMPLES = 60  # number of samples in the average, about two seconds; older ones count less


class PoseNoise:
    """Estimates the covariance of poses from their deviations from smooth motion."""

    def __init__(self) -> None:
        self._covariance: FloatArray = np.zeros((6, 6))
        self._num_samples = 0
        self.restart()

    def restart(self) -> None:
        """Drop the recent poses, because the motion is interrupted."""
        self._poses: deque[tuple[int, FloatArray]] = deque(maxlen=WINDOW)

    def add(self, stamp_ns: int, T_odom_camera: FloatArray) -> None:
        """Add the pose (4, 4) of the next image; five poses within 0.3 s give a sample."""
        if self._poses and stamp_ns <= self._poses[-1][0]:
            self.restart()
        self._poses.append((stamp_ns, T_odom_camera))
        elapsed_s = S_PER_NS * (stamp_ns - self._poses[0][0])
        if len(self._poses) == WINDOW and elapsed_s <= _MAX_WINDOW_S:
            stamps_ns, T = zip(*self._poses, strict=True)
            (error,) = smoothness_residuals(np.array([stamps_ns]), np.array([T]))
            self._num_samples = min(self._num_samples + 1, _MAX_SAMPLES)
            self._covariance += (np.outer(error, error) - self._covariance) / self._num_samples

    def covariance(self, prior: FloatArray) -> FloatArray | None:
        """Return a pose's covariance (6, 6) in the camera frame, rotation first; None if unknown.

        The `prior`, from the residuals of the pose, outweighs the measured covariance as long as
        there are fewer than five samples.
        """
        if self._num_samples == 0:
            return None
        total = _PRIOR_SAMPLES * prior + self._num_samples * self._covariance
        return np.asarray(total / (_PRIOR_SAMPLES + self._num_samples))


class LastingNoise:
    """Estimates the covariance of poses by errors of the map, the calibration and the shutter.

    They displace the poses of near and of distant points differently, but in many images alike.
    The mean square of the difference, less the independent noise, is the variance of both poses.
    """

    def __init__(self) -> None:
        self._square: FloatArray = np.zeros((6, 6))
        self._num_samples = 0
        self.covariance = self._square  # (6, 6) in the camera frame, rotation first

    def add(self, disagreement: FloatArray) -> None:
        """Add the square (6, 6) of a difference less its noise (`Consensus.disagreement`)."""
        self._num_samples = min(self._num_samples + 1, _MAX_SAMPLES)
        self._square = self._square + (disagreement - self._square) / self._num_samples
        variances, axes = np.linalg.eigh(self._square)
        self.covariance = np.asarray((axes * np.maximum(variances, 0)) @ axes.T / 2)


def smoothness_residuals(stamps_ns: IntArray, T_odom_camera: FloatArray) -> FloatArray:
    """Return the deviations (N, 6) of middle poses from the parabola through the others.

    They are twists from the middle pose to the parabola, in the middle camera's frame, rotation
    first (rad, m), scaled to the error of a single pose for equal noise of all. The stamps (N,
    WINDOW) of successive poses increase strictly.
    """
    others = np.arange(WINDOW) != _HALF_WINDOW
    times_s = S_PER_NS * (stamps_ns[:, others] - stamps_ns[:, _HALF_WINDOW, None])
    powers = times_s[..., None] ** np.arange(_DEGREE + 1)
    # Weights of the other poses in the parabola's value at time 0.
    weights = np.linalg.pinv(powers)[:, 0]
    T_middle_others = se3.inverse(T_odom_camera[:, _HALF_WINDOW, None]) @ T_odom_camera[:, others]
    deviation = (weights[:, None] @ se3.log(T_middle_others))[:, 0]
    return np.asarray(deviation / np.sqrt(1 + np.square(weights).sum(1, keepdims=True)))
