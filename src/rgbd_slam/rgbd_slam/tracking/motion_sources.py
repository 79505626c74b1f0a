"""Motion sources, which predict the motion of the camera between images.

To add a source, pass an object with the interface `MotionSource` to `SlamSession`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray

# Not tuned: time over which differences between external odometry and tracking are averaged.
_AVERAGING_S = 2.0
# Not tuned: standard deviation of the velocity of external odometry (rad/s, m/s) before it is
# compared with the camera.
_INITIAL_ERROR_PER_S = np.array([0.1] * 3 + [0.1] * 3)

MotionLookup = Callable[[int, int], FloatArray | None]
"""Returns the camera motion T_first_second (4, 4) between two stamps [ns]; None if unknown."""


class BridgedMotion(NamedTuple):
    """The camera motion since the last tracked frame, measured without images."""

    T_last_camera: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6) in the camera frame, rotation first [rad^2, m^2]
    # (6, 6) part of `covariance` whose errors are independent between images.
    image_covariance: FloatArray
    elapsed_s: float  # time since the last tracked frame
    source: str = 'the wheel odometry'  # name of the sensor in the status
    # Whether the source bridges only a short time, in which its poses are as accurate as tracked
    # ones and are recorded in the trajectory.
    is_short: bool = False


class MotionSource(Protocol):
    """Predicts the motion of the camera from a tracked frame (`start`) to an image (`advance`)."""

    def start(self, stamp_ns: int) -> None:
        """Set the stamp of the tracked frame."""

    def advance(self, stamp_ns: int) -> None:
        """Set the stamp of the image."""

    def observe(self, T_last_camera: FloatArray) -> None:
        """Learn from the motion T_last_camera (4, 4) tracked from `start` to this image."""

    def predict(self) -> FloatArray | None:
        """Return the predicted motion T_camera_last (4, 4); None if it is unknown."""

    def bridge(self) -> BridgedMotion | None:
        """Return the measured T_last_camera with covariances; None if it was not measured."""


class ExternalOdometry:
    """Motion from external odometry, such as wheels, whose error is learned."""

    def __init__(self, lookup: MotionLookup) -> None:
        self._lookup = lookup
        # (6,) variance of the velocity.
        self._variance_per_s2: FloatArray = np.square(_INITIAL_ERROR_PER_S)
        self._start_ns = self._stamp_ns = self._step_ns = 0
        self._T_last_camera: FloatArray | None = None

    def start(self, stamp_ns: int) -> None:
        self._start_ns = self._stamp_ns = stamp_ns
        self._T_last_camera = np.eye(4)

    def advance(self, stamp_ns: int) -> None:
        """Add the motion up to this stamp; after a gap, the motion is unknown until `start`."""
        T = self._T_last_camera
        if T is not None:
            step = self._lookup(self._stamp_ns, stamp_ns)
            self._T_last_camera = None if step is None else T @ step
        self._step_ns, self._stamp_ns = stamp_ns - self._stamp_ns, stamp_ns

    def observe(self, T_last_camera: FloatArray) -> None:
        if self._T_last_camera is not None and self._elapsed_s > 0:
            error = se3.log(se3.inverse(T_last_camera) @ self._T_last_camera) / self._elapsed_s
            weight = min(self._elapsed_s / _AVERAGING_S, 1.0)
            self._variance_per_s2 += weight * (np.square(error) - self._variance_per_s2)

    def predict(self) -> FloatArray | None:
        return None if self._T_last_camera is None else se3.inverse(self._T_last_camera)

    def bridge(self) -> BridgedMotion | None:
        """Return the measured motion, or None if it is unknown.

        Its standard deviation grows linearly with time, because the error of a wheel's velocity
        persists. `image_covariance` is half the covariance of the motion between two images, so
        that the difference of two poses has the covariance of that motion.
        """
        if self._T_last_camera is None:
            return None
        variance = np.diag(self._variance_per_s2)
        return BridgedMotion(
            self._T_last_camera,
            variance * self._elapsed_s**2,
            variance * (S_PER_NS * self._step_ns) ** 2 / 2,
            self._elapsed_s,
        )

    @property
    def _elapsed_s(self) -> float:
        return S_PER_NS * (self._stamp_ns - self._start_ns)
