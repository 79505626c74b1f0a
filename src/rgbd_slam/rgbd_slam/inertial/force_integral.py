"""Integrals of the specific force that an accelerometer measures, turned by the gyro."""

from __future__ import annotations

import numpy as np

from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray, IntArray
from rgbd_slam.inertial.gyro_integral import (
    RateIntegral,
    interpolated,
    rotation_vector,
    rotations,
)
from rgbd_slam.inertial.sample_buffer import GAP_NS, SampleBuffer, Samples

# Chosen: for this long before the first and after the newest sample its force is held, as the rate
# of a gyro is.
_HELD_NS = NS_PER_S // 40


class ForceIntegral:
    """The double integral of the specific force, along the axes of the camera at one time.

    Args:
        times_s: (N,) increasing times.
        forces_mps2: (N, 3) specific force along the axes of the IMU, without bias.
        R_camera_imu: (N, 3, 3) rotations of the IMU relative to the camera at the one time.
    """

    def __init__(
        self, times_s: FloatArray, forces_mps2: FloatArray, R_camera_imu: FloatArray
    ) -> None:
        self._times_s, self._R_camera_imu = times_s, R_camera_imu
        turned = np.einsum('nij,nj->ni', R_camera_imu, forces_mps2)
        step_s = np.diff(times_s)[:, None]
        # The force is linear between samples, so that these sums are exact.
        self._velocity_mps = _sums(0.5 * step_s * (turned[1:] + turned[:-1]))
        self._moved_m = _sums(
            step_s * self._velocity_mps[:-1] + step_s**2 * (2 * turned[:-1] + turned[1:]) / 6
        )

    def moved_m(self, times_s: FloatArray, origin_s: float) -> FloatArray:
        """Return the double integrals (M, 3) from one time to times (M,), also before it."""
        origin = np.array([origin_s])
        velocity_mps = interpolated(origin, self._times_s, self._velocity_mps)
        ends_m = interpolated(np.append(times_s, origin_s), self._times_s, self._moved_m)
        return np.asarray(ends_m[:-1] - ends_m[-1] - (times_s - origin_s)[:, None] * velocity_mps)

    def turns_rad(self, times_s: FloatArray, origin_s: float) -> FloatArray:
        """Return the angles (M,) by which the camera has turned from one time to times (M,)."""
        last = len(self._times_s) - 1
        k = np.minimum(np.searchsorted(self._times_s, np.append(times_s, origin_s)), last)
        R = self._R_camera_imu[k]
        return np.asarray(np.linalg.norm(rotation_vector(R[-1].T @ R[:-1]), axis=1))


def force_integral(
    accelerometer: SampleBuffer,
    gyro: SampleBuffer,
    ends_ns: tuple[int, int, int],
    R_camera_imu: FloatArray,
    biases: tuple[FloatArray, FloatArray],
) -> ForceIntegral | None:
    """Return the integrals of the force between two times by the clock of the IMU.

    None is returned if the samples of a sensor begin more than 25 ms too late, end more than 25 ms
    too early or leave a gap of more than 50 ms.

    Args:
        accelerometer: Samples of the specific force.
        gyro: Samples of the rates.
        ends_ns: Start, origin and end of the time.
        R_camera_imu: (3, 3)
        biases: (3,) of the gyro [rad/s] and (3,) of the accelerometer [m/s^2], along the axes of
            the IMU.
    """
    first_ns, origin_ns, last_ns = ends_ns
    samples = accelerometer.between(first_ns, last_ns)
    both = samples, gyro.between(first_ns, last_ns)
    if not all(_covers(known, first_ns, last_ns) for known in both):
        return None
    is_within = (samples.stamps_ns > first_ns) & (samples.stamps_ns < last_ns)
    knots_ns: IntArray = np.unique(np.append(samples.stamps_ns[is_within], ends_ns))
    times_s = _seconds(knots_ns - origin_ns)
    known_s = _seconds(samples.stamps_ns - origin_ns)
    forces_mps2 = interpolated(times_s, known_s, samples.values) - biases[1]
    turned_rad = RateIntegral(gyro, first_ns, last_ns).over(knots_ns[:-1], knots_ns[1:], 0.0)
    turned_rad = turned_rad - np.diff(times_s)[:, None] * biases[0]
    R_first_imu = _products(np.concatenate([np.eye(3)[None], rotations(turned_rad)]))
    R_origin_first = R_first_imu[int(np.searchsorted(knots_ns, origin_ns))].T
    return ForceIntegral(times_s, forces_mps2, R_camera_imu @ R_origin_first @ R_first_imu)


def _covers(samples: Samples, first_ns: int, last_ns: int) -> bool:
    stamps_ns = samples.stamps_ns
    if len(stamps_ns) < 2 or stamps_ns[0] > first_ns + _HELD_NS:
        return False
    if stamps_ns[-1] + _HELD_NS < last_ns:
        return False
    return bool(np.diff(stamps_ns).max() <= GAP_NS)


def _seconds(elapsed_ns: IntArray) -> FloatArray:
    return np.asarray(S_PER_NS * elapsed_ns, np.float64)


def _sums(steps: FloatArray) -> FloatArray:
    """Return the sums (N + 1, 3) of the first 0 to N steps (N, 3)."""
    return np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _products(R: FloatArray) -> FloatArray:
    """Return the products (N, 3, 3) of the first 1 to N rotations (N, 3, 3), by doubling."""
    reach = 1
    while reach < len(R):
        R = np.concatenate([R[:reach], R[:-reach] @ R[reach:]])
        reach *= 2
    return R
