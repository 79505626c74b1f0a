"""A gyroscope as external odometry, which predicts the rotation of the camera between images."""

import numpy as np

from hoid_common import se3
from hoid_common.poses.frames import PoseBuffer
from hoid_common.values import S_PER_NS, FloatArray


class Gyroscope:
    """Integrates angular velocities of the camera; the camera is assumed not to translate."""

    def __init__(self) -> None:
        self._poses = PoseBuffer()
        self._T_start_camera: FloatArray = np.eye(4)
        self._stamp_ns: int | None = None

    def add(self, stamp_ns: int, angular_velocity_radps: FloatArray) -> None:
        """Add the angular velocity (3,) in the camera frame since the previous stamp."""
        if self._stamp_ns is not None:
            elapsed_s = S_PER_NS * (stamp_ns - self._stamp_ns)
            turn = se3.exp(np.concatenate([elapsed_s * angular_velocity_radps, np.zeros(3)]))
            self._T_start_camera = self._T_start_camera @ turn
        self._stamp_ns = stamp_ns
        self._poses.add(stamp_ns, self._T_start_camera)

    def motion(self, first_ns: int, second_ns: int) -> FloatArray | None:
        """Return T_first_second (4, 4) between two stamps, or None if a stamp is not covered."""
        T_start_first, T_start_second = self._poses.at(first_ns), self._poses.at(second_ns)
        if T_start_first is None or T_start_second is None:
            return None
        return se3.inverse(T_start_first) @ T_start_second
