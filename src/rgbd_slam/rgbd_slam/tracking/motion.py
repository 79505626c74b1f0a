"""How the camera is expected to move: as fast as it did last, or as the wheels say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray

_HORIZON_S = 0.25  # a hand changes its motion; nobody knows where it is after a longer gap
_MEMORY_S = 2.0  # in which wheels and camera are compared
# What wheels may err by before they were compared with the camera [rad/s, m/s].
_WHEEL_ERROR_PER_S = np.array([0.1] * 3 + [0.1] * 3)

MotionSource = Callable[[int, int], FloatArray | None]
"""Returns T_first_second (4, 4) of the camera for two stamps [ns], or None where unknown."""


class ConstantVelocity:
    """Predicts motions between two images from the last one observed; at rest to begin with."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Expect no motion, until one is observed."""
        self.twist: FloatArray = np.zeros(6)  # of points in the camera's frame: rad/s, then m/s

    def observe(self, T_camera_last: FloatArray, elapsed_ns: int) -> None:
        """Take the motion (4, 4) between two images; stamps that stand still say no speed."""
        if elapsed_ns > 0:
            self.twist = se3.log(T_camera_last) / (S_PER_NS * elapsed_ns)
        else:
            self.forget()

    def predict(self, elapsed_ns: int) -> FloatArray:
        """Return T_camera_last (4, 4), the motion expected in a time."""
        elapsed_s = min(max(S_PER_NS * elapsed_ns, 0.0), _HORIZON_S)
        return se3.exp(elapsed_s * self.twist)


class WheelMotion:
    """The camera's way since it was tracked last, by odometry that somebody else has.

    How far that is believed, its errors against the camera's own motion say: wheels slip.

    Args:
        source: Of that odometry.
    """

    def __init__(self, source: MotionSource) -> None:
        self._source = source
        self._error_per_s2: FloatArray = np.square(_WHEEL_ERROR_PER_S)  # (6,) mean squares
        self._from_ns = self._to_ns = self._step_ns = 0
        self.T_last_now: FloatArray | None = None  # (4, 4)

    def begin(self, stamp_ns: int) -> None:
        """Start from an image with a pose."""
        self._from_ns = self._to_ns = stamp_ns
        self.T_last_now = np.eye(4)

    def follow(self, stamp_ns: int) -> None:
        """Go on to the next image; once the wheels say nothing, the way is unknown."""
        if self.T_last_now is not None:
            step = self._source(self._to_ns, stamp_ns)
            self.T_last_now = None if step is None else self.T_last_now @ step
        self._step_ns, self._to_ns = stamp_ns - self._to_ns, stamp_ns

    def compare(self, T_last_now: FloatArray) -> None:
        """Learn from the motion (4, 4) that the camera saw meanwhile."""
        if self.T_last_now is not None and self.elapsed_s > 0:
            error = se3.log(se3.inverse(T_last_now) @ self.T_last_now) / self.elapsed_s
            share = min(self.elapsed_s / _MEMORY_S, 1.0)
            self._error_per_s2 += share * (np.square(error) - self._error_per_s2)

    @property
    def elapsed_s(self) -> float:
        """Return the time since the image that it began with."""
        return S_PER_NS * (self._to_ns - self._from_ns)

    @property
    def covariance(self) -> FloatArray:
        """Return (6, 6) of the way, rotation first: an error of wheels goes on and on."""
        return np.diag(self._error_per_s2) * self.elapsed_s**2

    @property
    def image_covariance(self) -> FloatArray:
        """Return (6, 6) of one image, as their velocity has when two are compared."""
        return np.diag(self._error_per_s2) * (S_PER_NS * self._step_ns) ** 2 / 2
