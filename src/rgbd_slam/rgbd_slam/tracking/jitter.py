"""By how much poses of images in a row jitter: the errors that no residual tells of.

What the matches of an image err by together, as by a shutter that rolls or a depth image of
another instant, moves its pose and leaves them in agreement. But a camera moves smoothly: a
parabola fits five images, and what the middle one is off that through the others is its error.
Faster shakes count as errors as well.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray, IntArray

_REACH = 2  # images on either side
WINDOW = 2 * _REACH + 1
_DEGREE = 2
_LONGEST_S = 0.3  # of those five images: in a longer time a hand does what no parabola does
_PRIOR = 5  # errors that what residuals tell counts as
_MEMORY = 60  # errors


class Jitter:
    """Averages the squares of errors against a smooth motion, over the last two seconds or so."""

    def __init__(self) -> None:
        self._squares: FloatArray = np.zeros((6, 6))
        self._num_errors = 0
        self.restart()

    def restart(self) -> None:
        """Expect no smooth motion to the next pose."""
        self._poses: deque[tuple[int, FloatArray]] = deque(maxlen=WINDOW)

    def add(self, stamp_ns: int, T_odom_camera: FloatArray) -> None:
        """Take the next image's pose (4, 4)."""
        if self._poses and stamp_ns <= self._poses[-1][0]:
            self.restart()
        self._poses.append((stamp_ns, T_odom_camera))
        elapsed_s = S_PER_NS * (stamp_ns - self._poses[0][0])
        if len(self._poses) == WINDOW and elapsed_s <= _LONGEST_S:
            stamps_ns, T = zip(*self._poses, strict=True)
            (error,) = middle_errors(np.array([stamps_ns]), np.array([T]))
            self._num_errors = min(self._num_errors + 1, _MEMORY)
            self._squares += (np.outer(error, error) - self._squares) / self._num_errors

    def covariance(self, told: FloatArray) -> FloatArray | None:
        """Return (6, 6) of a small motion of the camera, rotation first; None while unknown.

        Args:
            told: (6, 6) as residuals tell, which few errors are not to contradict.
        """
        if self._num_errors == 0:
            return None
        total = _PRIOR * told + self._num_errors * self._squares
        return np.asarray(total / (_PRIOR + self._num_errors))


def middle_errors(stamps_ns: IntArray, T_odom_camera: FloatArray) -> FloatArray:
    """Return (N, 6) by how much middle poses are off the others' parabola, as a pose errs alone.

    Args:
        stamps_ns: (N, WINDOW) of poses in a row.
        T_odom_camera: (N, WINDOW, 4, 4).
    """
    others = np.arange(WINDOW) != _REACH
    times_s = S_PER_NS * (stamps_ns[:, others] - stamps_ns[:, _REACH, None])
    powers = times_s[..., None] ** np.arange(_DEGREE + 1)
    weights = np.linalg.pinv(powers)[:, 0]  # of the others' poses, for that at time 0
    T_middle_others = se3.inverse(T_odom_camera[:, _REACH, None]) @ T_odom_camera[:, others]
    off = (weights[:, None] @ se3.log(T_middle_others))[:, 0]
    return np.asarray(off / np.sqrt(1 + np.square(weights).sum(1, keepdims=True)))
