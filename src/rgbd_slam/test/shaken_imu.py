"""A hand-held camera with an IMU whose mounting, delay, biases and faults are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.inertial.mounting import Mounting
from rgbd_slam.inertial.sample_buffer import Samples

START_NS = 1_000 * NS_PER_S
IMAGE_NS, IMU_NS = NS_PER_S // 30, NS_PER_S // 200
UP_WORLD: FloatArray = np.array([0.0, 0.0, 1.0])
_EPS_S = 1e-4
# Frequencies [Hz] and amplitudes [rad, m] of the motion along each axis: up to 1 rad/s, 1 m/s^2.
_TURN_HZ, _TURN_RAD = np.array([0.41, 0.53, 0.67]), np.array([0.25, 0.3, 0.2])
_MOVE_HZ, _MOVE_M = np.array([0.61, 0.47, 0.79]), np.array([0.08, 0.1, 0.06])
# The camera looks down by 30 degrees and is rolled by 20 at the start.
_R_WORLD_START: FloatArray = se3.exp(np.array([0.3, 0.2, -0.5, 0, 0, 0]))[:3, :3] @ np.array(
    [[0.0, -0.5, 0.866025], [-1.0, 0.0, 0.0], [0.0, -0.866025, -0.5]]
)
POSE_NOISE_RAD, POSE_NOISE_M = 2e-3, 2e-3


def pose(time_s: float) -> FloatArray:
    """Return T_world_camera (4, 4) of the shaken camera."""
    turn = _TURN_RAD * np.sin(2 * np.pi * _TURN_HZ * time_s)
    T = np.eye(4)
    T[:3, :3] = _R_WORLD_START @ se3.exp(np.r_[turn, np.zeros(3)])[:3, :3]
    T[:3, 3] = _MOVE_M * np.sin(2 * np.pi * _MOVE_HZ * time_s)
    return T


def rate(time_s: float) -> FloatArray:
    """Return the angular velocity (3,) in the camera frame."""
    T = se3.inverse(pose(time_s - _EPS_S)) @ pose(time_s + _EPS_S)
    return se3.log(T)[:3] / (2 * _EPS_S)


def force(time_s: float) -> FloatArray:
    """Return the specific force (3,) in the camera frame: acceleration plus gravity upwards."""
    before, now, after = (pose(time_s + s) for s in (-0.01, 0.0, 0.01))
    acceleration = (before[:3, 3] - 2 * now[:3, 3] + after[:3, 3]) / 0.01**2
    return np.asarray(now[:3, :3].T @ (acceleration + 9.81 * UP_WORLD))


class ShakenImu:
    """Feeds an `Imu` with the samples and the tracked motion of the shaken camera.

    Args:
        R_camera_imu: (3, 3) true mounting.
        offset_s: Time by which the stamps of the IMU are later.
        gyro_bias: (3,) rad/s.
        given: The mounting that the `Imu` is told; None: none.
        distort: Changes the rates (N, 3) and returns the faulty ones; None: no fault. It may be
            set later.
        distort_force: The same for the accelerations (N, 3).
        accelerometer: Whether there is one.
        gyro: Whether there is one.
        config: Parameters of the `Imu`; None: the defaults.
    """

    def __init__(
        self,
        R_camera_imu: FloatArray | None = None,
        offset_s: float = 0.0,
        gyro_bias: FloatArray | None = None,
        given: Mounting | None = None,
        distort: Callable[[FloatArray], FloatArray] | None = None,
        *,
        distort_force: Callable[[FloatArray], FloatArray] | None = None,
        accelerometer: bool = False,
        gyro: bool = True,
        seed: int = 0,
        config: ImuConfig | None = None,
    ) -> None:
        self.imu = Imu(config or ImuConfig(), given)
        self._R_imu_camera = np.eye(3) if R_camera_imu is None else R_camera_imu.T
        self._offset_s, self.distort, self.distort_force = offset_s, distort, distort_force
        self._bias = np.zeros(3) if gyro_bias is None else gyro_bias
        self._accelerometer, self._gyro = accelerometer, gyro
        self._rng = np.random.default_rng(seed)
        self._image = 0
        self.is_silent = False  # True: no samples arrive
        self._sampled_ns = -NS_PER_S // 2
        self._T_world_tracked = pose(0.0)

    @property
    def time_s(self) -> float:
        """Return the time of the latest image."""
        return S_PER_NS * self._image * IMAGE_NS

    def run(self, duration_s: float) -> None:
        """Track images for a while."""
        while self.time_s < duration_s:
            first_ns = START_NS + self._image * IMAGE_NS
            self._image += 1
            self.sample(self._image * IMAGE_NS + NS_PER_S // 10)
            noise = np.r_[
                self._rng.normal(0, POSE_NOISE_RAD, 3), self._rng.normal(0, POSE_NOISE_M, 3)
            ]
            T = pose(self.time_s) @ se3.exp(noise)
            self.imu.observe(first_ns, first_ns + IMAGE_NS, se3.inverse(self._T_world_tracked) @ T)
            self._T_world_tracked = T

    def sample(self, until_ns: int) -> None:
        """Add the samples up to a time (ns since the start)."""
        times_ns = np.arange(self._sampled_ns, until_ns, IMU_NS)
        if not len(times_ns):
            return
        self._sampled_ns = int(times_ns[-1]) + IMU_NS
        if self.is_silent:
            return
        times_s = S_PER_NS * times_ns - self._offset_s
        stamps_ns = START_NS + times_ns
        if self._gyro:
            rates = np.stack([rate(s) for s in times_s.tolist()]) @ self._R_imu_camera.T
            rates += self._bias + self._rng.normal(0, 2e-3, rates.shape)
            rates = rates if self.distort is None else self.distort(rates)
            self.imu.add_rates(Samples(stamps_ns, rates))
        if self._accelerometer:
            forces = np.stack([force(s) for s in times_s.tolist()]) @ self._R_imu_camera.T
            forces += self._rng.normal(0, 0.02, forces.shape)
            forces = forces if self.distort_force is None else self.distort_force(forces)
            self.imu.add_accelerations(Samples(stamps_ns, forces))
