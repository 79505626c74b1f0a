"""The direction of gravity from an accelerometer and the tracked motion of the camera.

Over three images at t0 < t1 < t2, the change of the mean velocity is an exact integral of the
acceleration, weighted by the triangle that is 0 at t0 and t2 and 1 at t1:

    (p2 - p1) / (t2 - t1) - (p1 - p0) / (t1 - t0) = integral of weight * acceleration.

The measured specific force, rotated by the tracked rotations, is this acceleration plus gravity
upwards. No second derivative of noisy positions is needed (compare the preintegration of Forster
et al., T-RO 2017). The equation is linear in the rotation between camera and IMU, in the bias of
the accelerometer and in gravity, so that each triple is stored once, as a tensor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray
from rgbd_slam.inertial.gyro_integral import rotation_vector, rotations
from rgbd_slam.inertial.mounting import Mounting, snapped
from rgbd_slam.inertial.sample_buffer import GAP_NS, SampleBuffer

GRAVITY_MPS2 = 9.81  # within 0.3 % everywhere at sea level
_HALF_NS = NS_PER_S // 4  # chosen: between the images of a triple
_EPOCH_NS = NS_PER_S // 10  # chosen: between the centers of successive triples
_KEPT_NS = 30 * NS_PER_S  # chosen: the tracked rotation drifts by about 1 degree in this time
_MAX_STEP_NS = NS_PER_S // 5  # chosen: the rotation is interpolated over shorter steps only
# Chosen: triples before a direction is given, somewhat more than a second after the first image;
# and the fewest samples of a triple.
_MIN_EPOCHS = 10
_ROUNDS = 4  # Gauss-Newton converges in two or three from a start within 30 degrees; not tuned
# Chosen: standard deviations of the acceleration of one triple of images, of the length of gravity
# (the scale of cheap sensors is off by 2 %), and of the bias of an accelerometer that its driver
# has calibrated. If the last one is 0.3, the estimated bias takes up errors of the tracked
# rotation: the error after 6 s of fr1_xyz is then 3.9 instead of 1.5 degrees.
_TRIPLE_MPS2, _LENGTH_MPS2, _BIAS_MPS2 = 0.15, 0.2, 0.1
_MAX_ROTATION_SIGMA_RAD = np.deg2rad(12.0)  # chosen: far below the 90 degrees between axes
# Chosen: the scale of a cheap accelerometer is off by up to 0.2 m/s^2 at the length of gravity; an
# accelerometer in another unit is off by more than this limit.
_MAX_LENGTH_ERROR_MPS2 = 1.0
_MEDIAN_LENGTH = 1.54  # of a vector of three normally distributed numbers with the variance 1
_CAUCHY = 2.0  # chosen: triples with residuals of this multiple of the median weigh half


class GravityFit(NamedTuple):
    """Gravity, and the mounting and bias of the accelerometer, by the tracked motion."""

    up_camera: FloatArray  # (3,) unit vector opposite to gravity, in the latest camera frame
    up_sigma_rad: float  # standard deviation of its direction
    R_camera_imu: FloatArray  # (3, 3)
    rotation_sigma_rad: float  # largest standard deviation about any axis
    bias_mps2: FloatArray  # (3,) along the axes of the camera


class _Triple(NamedTuple):
    """The equation of three images; see the docstring of this module."""

    stamp_ns: int
    force: FloatArray  # (3, 9) maps the elements of R_camera_imu to the mean force in the chain
    mean_rotation: FloatArray  # (3, 3) maps a bias in the camera frame to the chain
    acceleration_mps2: FloatArray  # (3,) by the tracked positions, in the chain


class GravityEstimator:
    """Estimates the direction of gravity in the camera frame from a chain of tracked motions.

    The rotation between camera and IMU and the bias of the accelerometer are estimated as well.
    """

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._T_chain_camera: list[FloatArray] = []
        self._triples: list[_Triple] = []
        self._center_ns = 0  # of the last triple that was tried

    def add(self, first_ns: int, second_ns: int, T_first_second: FloatArray) -> None:
        """Add the tracked motion (4, 4) between two images.

        If `first_ns` is not the stamp of the last image, or the stamps do not increase, a new
        chain is started: all earlier motions and equations are dropped.
        """
        if not self._stamps_ns or first_ns != self._stamps_ns[-1] or second_ns <= first_ns:
            self._stamps_ns, self._T_chain_camera, self._triples = [first_ns], [np.eye(4)], []
            self._center_ns = first_ns
        if second_ns > first_ns:
            self._stamps_ns.append(second_ns)
            self._T_chain_camera.append(
                se3.orthonormalized(self._T_chain_camera[-1] @ T_first_second)
            )

    def measure(self, accelerometer: SampleBuffer, offset_ns: int) -> None:
        """Store the equations of the triples of images that samples have arrived for.

        Motions and equations that are more than 30 s old are dropped.

        Args:
            accelerometer: The samples.
            offset_ns: Time by which the stamps of the IMU are later than those of the images.
        """
        newest_ns = accelerometer.newest_ns
        if newest_ns is None or not self._stamps_ns:
            return
        end_ns = min(self._stamps_ns[-1], newest_ns - offset_ns)
        # After a step of the clock, the time between two images may be years.
        self._center_ns = max(self._center_ns, end_ns - _KEPT_NS)
        while self._center_ns + _EPOCH_NS + _HALF_NS <= end_ns:
            self._center_ns += _EPOCH_NS
            triple = self._triple(accelerometer, offset_ns, self._center_ns)
            if triple is not None:
                self._triples.append(triple)
        self._forget_old(end_ns)

    def fit(self, mounting: Mounting | None) -> GravityFit | None:
        """Return gravity by all stored triples of images.

        None is returned if there are fewer than 10 triples, if the rotation of the IMU is neither
        given nor determined by them to 12 degrees (one standard deviation), or if the length of
        gravity is off by more than 1 m/s^2. Standard deviations grow with the residuals, so that
        an accelerometer that contradicts the tracked motion determines nothing.

        Args:
            mounting: Its rotation is refined, with its standard deviation as a prior. None: the
                rotation is estimated, which needs accelerations in all directions.
        """
        if len(self._triples) < _MIN_EPOCHS:
            return None
        force = np.stack([triple.force for triple in self._triples])
        turned = np.stack([triple.mean_rotation for triple in self._triples])
        acceleration = np.stack([triple.acceleration_mps2 for triple in self._triples])
        if mounting is None:
            start = _linear_rotation(force, acceleration)
            solved = _solve(force, turned, acceleration, start, np.pi)
            if solved.rotation_sigma_rad > _MAX_ROTATION_SIGMA_RAD:
                return None
            mounting = Mounting(snapped(solved.R_camera_imu, solved.rotation_sigma_rad))
        solved = _solve(force, turned, acceleration, mounting.R_camera_imu, mounting.sigma_rad)
        length_mps2 = float(np.linalg.norm(solved.gravity_mps2))
        if abs(length_mps2 - GRAVITY_MPS2) > _MAX_LENGTH_ERROR_MPS2:
            return None
        up_chain = solved.gravity_mps2 / length_mps2
        return GravityFit(
            self._T_chain_camera[-1][:3, :3].T @ up_chain,
            solved.up_sigma_rad,
            solved.R_camera_imu,
            solved.rotation_sigma_rad,
            solved.bias_mps2,
        )

    def _triple(
        self, accelerometer: SampleBuffer, offset_ns: int, center_ns: int
    ) -> _Triple | None:
        """Return the equation of the images nearest to a time and `_HALF_NS` before and after.

        None is returned if samples or images are missing.
        """
        stamps_ns = np.array(self._stamps_ns)
        wanted_ns = center_ns + _HALF_NS * np.array([-1, 0, 1])
        after = np.clip(np.searchsorted(stamps_ns, wanted_ns), 1, len(stamps_ns) - 1)
        before = after - 1
        is_before = wanted_ns - stamps_ns[before] < stamps_ns[after] - wanted_ns
        i0, i1, i2 = np.where(is_before, before, after).tolist()
        if not i0 < i1 < i2 or np.diff(stamps_ns[i0 : i2 + 1]).max() > _MAX_STEP_NS:
            return None
        times_s = S_PER_NS * (stamps_ns[i0 : i2 + 1] - stamps_ns[i1])
        poses = np.stack(self._T_chain_camera[i0 : i2 + 1])
        ends_s = times_s[[0, i1 - i0, -1]]
        p0, p1, p2 = poses[[0, i1 - i0, -1], :3, 3]
        step = (p2 - p1) / (ends_s[2] - ends_s[1]) - (p1 - p0) / (ends_s[1] - ends_s[0])
        low_ns, high_ns = int(stamps_ns[i0]) + offset_ns, int(stamps_ns[i2]) + offset_ns
        samples_ns, values = accelerometer.between(low_ns, high_ns)
        if len(samples_ns) < _MIN_EPOCHS or np.diff(samples_ns).max() > GAP_NS:
            return None
        if samples_ns[0] > low_ns or samples_ns[-1] < high_ns:
            return None
        samples_s = S_PER_NS * (samples_ns - offset_ns - stamps_ns[i1])
        weight = _triangle(samples_s, ends_s)
        R = _rotations_at(samples_s, times_s, poses[:, :3, :3])
        tensor = np.einsum('n,nij,nk->ijk', weight, R, values).reshape(3, 9)
        mean_rotation = np.einsum('n,nij->ij', weight, R)
        return _Triple(center_ns, tensor, mean_rotation, step / (0.5 * (ends_s[2] - ends_s[0])))

    def _forget_old(self, newest_ns: int) -> None:
        num_old = int(np.searchsorted(self._stamps_ns, newest_ns - _KEPT_NS))
        del self._stamps_ns[:num_old], self._T_chain_camera[:num_old]
        while self._triples and self._triples[0].stamp_ns < newest_ns - _KEPT_NS:
            self._triples.pop(0)


def _triangle(times_s: FloatArray, ends_s: FloatArray) -> FloatArray:
    """Return the weights (N,) of samples, with the sum 1.

    They are those of a triangle that is 0 at the first and the last of the three `ends_s`, and
    highest at the second.
    """
    height = np.interp(times_s, ends_s, [0.0, 1.0, 0.0], left=0.0, right=0.0)
    weight = height * np.gradient(times_s)
    return np.asarray(weight / weight.sum())


def _rotations_at(times_s: FloatArray, known_s: FloatArray, R_known: FloatArray) -> FloatArray:
    """Return rotations (N, 3, 3) between known ones (K, 3, 3), interpolated by constant rates.

    Before the first and after the last of the times `known_s`, the nearest known rotation is
    returned.
    """
    steps = rotation_vector(R_known[:-1].swapaxes(1, 2) @ R_known[1:])
    i = np.clip(np.searchsorted(known_s, times_s, side='right') - 1, 0, len(steps) - 1)
    share = (times_s - known_s[i]) / (known_s[i + 1] - known_s[i])
    return R_known[i] @ rotations(np.clip(share, 0.0, 1.0)[:, None] * steps[i])


class _Solution(NamedTuple):
    gravity_mps2: FloatArray  # (3,) upwards, in the chain
    up_sigma_rad: float
    R_camera_imu: FloatArray  # (3, 3)
    rotation_sigma_rad: float
    bias_mps2: FloatArray  # (3,) in the camera frame


def _linear_rotation(force: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the R_camera_imu (3, 3) that fits best if its nine elements are free.

    These elements are then orthonormalized. Gravity and bias are taken as one constant, as if the
    camera did not turn.
    """
    num = len(force)
    rows = np.concatenate([force, np.tile(-np.eye(3), (num, 1, 1))], axis=2).reshape(-1, 12)
    # Chosen: a weak prior of zero, so that a direction without acceleration gives no huge element.
    prior = np.diag([_TRIPLE_MPS2] * 9 + [0.0] * 3)
    rhs = np.append(acceleration.ravel(), np.zeros(12))
    found = np.linalg.lstsq(np.vstack([rows, prior]), rhs, rcond=None)[0]
    T = np.eye(4)
    T[:3, :3] = found[:9].reshape(3, 3)
    return se3.orthonormalized(T)[:3, :3]


def _solve(
    force: FloatArray,
    turned: FloatArray,
    acceleration: FloatArray,
    R: FloatArray,
    rotation_sigma_rad: float,
) -> _Solution:
    """Return the least-squares solution by Gauss-Newton, with priors of bias and length.

    Args:
        force: (N, 3, 9) of each triple.
        turned: (N, 3, 3) mean rotations.
        acceleration: (N, 3) by the tracked positions.
        R: (3, 3) rotation R_camera_imu to start with.
        rotation_sigma_rad: Standard deviation of `R` as a prior, about each axis.
    """
    num, R_given = len(force), R
    bias, weight = np.zeros(3), np.ones(num)
    gravity = ((force @ R.ravel()) - acceleration).mean(axis=0)
    gravity *= GRAVITY_MPS2 / max(float(np.linalg.norm(gravity)), 1e-3)
    normal = np.eye(9)
    for _ in range(_ROUNDS):
        measured = force @ R.ravel()
        residual = measured - turned @ bias - gravity - acceleration
        weight = _cauchy(residual)
        # R = exp(delta) R changes the force by the columns hat(e_k) @ R.
        generators = np.stack([(se3.hat(axis) @ R).ravel() for axis in np.eye(3)], axis=1)
        J = np.concatenate([force @ generators, -turned, np.tile(-np.eye(3), (num, 1, 1))], axis=2)
        J = (np.sqrt(weight)[:, None, None] * J / _TRIPLE_MPS2).reshape(-1, 9)
        r = (np.sqrt(weight)[:, None] * residual / _TRIPLE_MPS2).ravel()
        up = gravity / max(float(np.linalg.norm(gravity)), 1e-3)
        prior = np.zeros((7, 9))
        prior[:3, :3] = np.eye(3) / rotation_sigma_rad
        prior[3:6, 3:6] = np.eye(3) / _BIAS_MPS2
        prior[6, 6:] = up / _LENGTH_MPS2
        turned_by = rotation_vector(R @ R_given.T)
        length = float(np.linalg.norm(gravity)) - GRAVITY_MPS2
        r_prior = np.array(
            [*turned_by / rotation_sigma_rad, *bias / _BIAS_MPS2, length / _LENGTH_MPS2]
        )
        normal = J.T @ J + prior.T @ prior
        delta = -np.linalg.solve(normal, J.T @ r + prior.T @ r_prior)
        R = rotations(delta[None, :3])[0] @ R
        bias, gravity = bias + delta[3:6], gravity + delta[6:]
    residual = force @ R.ravel() - turned @ bias - gravity - acceleration
    typical_mps2 = float(np.median(np.linalg.norm(residual, axis=1))) / _MEDIAN_LENGTH
    covariance = max(typical_mps2 / _TRIPLE_MPS2, 1.0) ** 2 * np.linalg.inv(normal)
    up = gravity / np.linalg.norm(gravity)
    across = np.eye(3) - np.outer(up, up)
    up_covariance = across @ covariance[6:, 6:] @ across / GRAVITY_MPS2**2
    return _Solution(
        gravity,
        float(np.sqrt(np.linalg.eigvalsh(up_covariance)[-1])),
        R,
        float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])),
        bias,
    )


def _cauchy(residual: FloatArray) -> FloatArray:
    """Return the Cauchy weights (N,) of residuals (N, 3): 0.5 at twice their median length."""
    length = np.linalg.norm(residual, axis=1)
    limit = max(_CAUCHY * float(np.median(length)), 1e-3)
    return np.asarray(1.0 / (1.0 + np.square(length / limit)))
