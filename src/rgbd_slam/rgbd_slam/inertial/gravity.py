"""The direction of gravity from an accelerometer and the tracked motion of the camera.

Over three images at t0 < t1 < t2, the change of the mean velocity is an exact integral of the
acceleration, weighted by the triangle that is 0 at t0 and t2 and 1 at t1:

    (p2 - p1) / (t2 - t1) - (p1 - p0) / (t1 - t0) = integral of weight * acceleration.

The measured specific force, rotated by the tracked rotations, is this acceleration plus gravity
upwards, so that noisy positions are not differentiated twice (compare the preintegration of
Forster et al., T-RO 2017). The equation is linear in the rotation between camera and IMU, in the
bias of the accelerometer and in gravity. Each triple is therefore stored once, as a tensor.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray
from rgbd_slam.inertial.mounting import Mounting, snapped
from rgbd_slam.inertial.rotations import (
    cauchy_weights,
    nearest_rotation,
    rotation_vector,
    rotations,
)
from rgbd_slam.inertial.sample_buffer import SampleBuffer
from rgbd_slam.inertial.tracked_motion import TrackedMotion, TrackedPoses

GRAVITY_MPS2 = 9.81  # within 0.3 % everywhere at sea level
_HALF_NS = NS_PER_S // 4  # chosen: time between the images of a triple
_EPOCH_NS = NS_PER_S // 10  # chosen: time between the middle images of successive triples
# Chosen: the triples of 30 s, in which the tracked rotation drifts by about 1 degree.
_MAX_TRIPLES = 300
_MAX_STEP_NS = NS_PER_S // 5  # chosen: tracked rotations are not interpolated over a longer gap
# Chosen: least number of triples for a direction of gravity, which take somewhat more than a
# second, and least number of samples in a triple.
_MIN_EPOCHS = 10
_ROUNDS = 4  # Gauss-Newton converges in two or three from a start within 30 degrees; not tuned
# Chosen: standard deviations of the acceleration in one triple, of the length of gravity (the
# scale of cheap sensors is off by 2 %), and of the bias of an accelerometer that its driver has
# calibrated. With 0.3 for the bias, its estimate absorbs errors of the tracked rotation: the error
# after 6 s of fr1_xyz is then 3.9 instead of 1.5 degrees.
_TRIPLE_MPS2, _LENGTH_MPS2, _BIAS_MPS2 = 0.15, 0.2, 0.1
_MAX_ROTATION_SIGMA_RAD = np.deg2rad(12.0)  # chosen: far below 90 degrees, the angle of two axes
# Chosen: largest error of the length of gravity. Cheap accelerometers are off by up to 0.2 m/s^2;
# one that measures in another unit is off by more than this limit.
_MAX_LENGTH_ERROR_MPS2 = 1.0
# Median length of a vector of three normally distributed numbers with variance 1.
_MEDIAN_LENGTH = 1.54
# Chosen: a triple whose residual is this multiple of the median, or at least this size, has half
# the weight.
_CAUCHY, _LEAST_MPS2 = 2.0, 1e-3


class Gravity(NamedTuple):
    """Direction of gravity at an image, and mounting and bias of the accelerometer."""

    stamp_ns: int
    up_camera: FloatArray  # (3,) unit vector opposite to gravity
    sigma_rad: float  # standard deviation of the direction
    R_camera_imu: FloatArray  # (3, 3)
    rotation_sigma_rad: float  # largest standard deviation about any axis
    bias_mps2: FloatArray  # (3,) along the axes of the camera


class _Triple(NamedTuple):
    """The equation of a triple of images, in the chain's frame (see the module's docstring)."""

    force: FloatArray  # (3, 9) maps the elements of R_camera_imu to the mean specific force
    mean_rotation: FloatArray  # (3, 3) maps a bias in the camera frame to the chain's frame
    acceleration_mps2: FloatArray  # (3,) from the tracked positions


class GravityEstimator:
    """Estimates gravity in the camera frame, and mounting and bias of the accelerometer."""

    def __init__(self, motion: TrackedMotion) -> None:
        self._motion = motion
        self._triples: deque[_Triple] = deque(maxlen=_MAX_TRIPLES)
        # Stamp of the first image of the chain to which the triples belong.
        self._chain_ns: int | None = None
        self._center_ns = 0  # stamp in the middle of the last triple that was tried

    def measure(self, accelerometer: SampleBuffer, offset_ns: int) -> None:
        """Store the equations of the triples of images that were tracked since the last call."""
        if self._chain_ns != self._motion.chain_ns:
            self._chain_ns = self._center_ns = self._motion.chain_ns
            self._triples.clear()
        poses = self._motion.chain(self._center_ns - 2 * _HALF_NS)
        newest_ns = accelerometer.newest_ns
        if newest_ns is None or not len(poses.stamps_ns):
            return
        end_ns = min(int(poses.stamps_ns[-1]), newest_ns - offset_ns) - _HALF_NS
        # After a clock was set, the time between two images may be years.
        self._center_ns = max(self._center_ns, end_ns - _MAX_TRIPLES * _EPOCH_NS)
        while self._center_ns + _EPOCH_NS <= end_ns:
            self._center_ns += _EPOCH_NS
            triple = _triple(poses, accelerometer, offset_ns, self._center_ns)
            if triple is not None:
                self._triples.append(triple)

    def fit(self, mounting: Mounting | None) -> Gravity | None:
        """Return gravity from all stored triples of images; None if they do not determine it.

        This needs 10 triples, a rotation of the IMU that is given or known to 12 degrees, and a
        length of gravity that is right within 1 m/s^2. Standard deviations grow with the
        residuals, so that they are large if the accelerometer contradicts the tracked motion.

        Args:
            mounting: Its rotation, a prior with its standard deviation, is refined. If None, the
                rotation is estimated, which needs accelerations in all directions.
        """
        if len(self._triples) < _MIN_EPOCHS:
            return None
        equations = _Triple(*(np.stack(part) for part in zip(*self._triples, strict=True)))
        if mounting is None:
            found = _solve(equations, _linear_rotation(equations), np.pi)
            if found.rotation_sigma_rad > _MAX_ROTATION_SIGMA_RAD:
                return None
            mounting = Mounting(snapped(found.R_camera_imu, found.rotation_sigma_rad))
        found = _solve(equations, mounting.R_camera_imu, mounting.sigma_rad)
        length_mps2 = float(np.linalg.norm(found.up_camera))
        if abs(length_mps2 - GRAVITY_MPS2) > _MAX_LENGTH_ERROR_MPS2:
            return None
        stamps_ns, T_chain_camera = self._motion.chain()
        up_camera = T_chain_camera[-1, :3, :3].T @ found.up_camera / length_mps2
        return found._replace(stamp_ns=int(stamps_ns[-1]), up_camera=up_camera)


def _triple(
    poses: TrackedPoses, accelerometer: SampleBuffer, offset_ns: int, center_ns: int
) -> _Triple | None:
    """Return the equation of three images: at about a time, and 0.25 s before and after it."""
    wanted_ns = center_ns + _HALF_NS * np.array([-1, 0, 1])
    i0, i1, i2 = np.abs(poses.stamps_ns[:, None] - wanted_ns).argmin(axis=0).tolist()
    stamps_ns = poses.stamps_ns[i0 : i2 + 1]
    if not i0 < i1 < i2 or np.diff(stamps_ns).max() > _MAX_STEP_NS:
        return None
    first_ns, last_ns = (stamps_ns[[0, -1]] + offset_ns).tolist()
    samples = accelerometer.between(first_ns, last_ns)
    if len(samples) < _MIN_EPOCHS or not samples.cover(first_ns, last_ns):
        return None
    times_s = S_PER_NS * (stamps_ns - stamps_ns[i1 - i0])
    T = poses.T_chain_camera[i0 : i2 + 1]
    ends_s = times_s[[0, i1 - i0, -1]]
    velocity_mps = np.diff(T[[0, i1 - i0, -1], :3, 3], axis=0) / np.diff(ends_s)[:, None]
    samples_s = S_PER_NS * (samples.stamps_ns - offset_ns - stamps_ns[i1 - i0])
    height = np.interp(samples_s, ends_s, [0.0, 1.0, 0.0], left=0.0, right=0.0)
    weight = height * np.gradient(samples_s)
    weight /= weight.sum()
    R = _rotations_at(samples_s, times_s, T[:, :3, :3])
    return _Triple(
        np.einsum('n,nij,nk->ijk', weight, R, samples.values).reshape(3, 9),
        np.einsum('n,nij->ij', weight, R),
        (velocity_mps[1] - velocity_mps[0]) / (0.5 * (ends_s[2] - ends_s[0])),
    )


def _rotations_at(times_s: FloatArray, known_s: FloatArray, R_known: FloatArray) -> FloatArray:
    """Return rotations (N, 3, 3) interpolated between known ones (K, 3, 3) at constant rates."""
    steps = rotation_vector(R_known[:-1].swapaxes(1, 2) @ R_known[1:])
    i = np.clip(np.searchsorted(known_s, times_s, side='right') - 1, 0, len(steps) - 1)
    share = (times_s - known_s[i]) / (known_s[i + 1] - known_s[i])
    return R_known[i] @ rotations(np.clip(share, 0.0, 1.0)[:, None] * steps[i])


def _linear_rotation(equations: _Triple) -> FloatArray:
    """Return the rotation R_camera_imu (3, 3) nearest to the best-fitting 3x3 matrix."""
    force, _, acceleration = equations
    rows = np.concatenate([force, np.tile(-np.eye(3), (len(force), 1, 1))], axis=2).reshape(-1, 12)
    # Chosen: a weak prior of zero, so that elements without evidence do not become huge.
    prior = np.diag([_TRIPLE_MPS2] * 9 + [0.0] * 3)
    rhs = np.append(acceleration.ravel(), np.zeros(12))
    found = np.linalg.lstsq(np.vstack([rows, prior]), rhs, rcond=None)[0]
    return nearest_rotation(found[:9].reshape(3, 3))


def _solve(equations: _Triple, R: FloatArray, rotation_sigma_rad: float) -> Gravity:
    """Return the least-squares solution (Gauss-Newton) with priors of bias and gravity's length.

    `up_camera` of the result is gravity upwards (m/s^2) in the chain's frame. R (3, 3), an initial
    value of R_camera_imu, is a prior with the given standard deviation about each axis.
    """
    (force, turned, acceleration), R_given = equations, R
    minus_one, bias = np.tile(-np.eye(3), (len(force), 1, 1)), np.zeros(3)
    gravity = (force @ R.ravel() - acceleration).mean(axis=0)
    gravity *= GRAVITY_MPS2 / max(float(np.linalg.norm(gravity)), 1e-3)
    sigmas = np.array([rotation_sigma_rad] * 3 + [_BIAS_MPS2] * 3 + [_LENGTH_MPS2])
    prior, normal = np.zeros((7, 9)), np.eye(9)
    prior[:6, :6] = np.eye(6)
    for _ in range(_ROUNDS):
        residual = force @ R.ravel() - turned @ bias - gravity - acceleration
        lengths = np.linalg.norm(residual, axis=1)
        weight = np.sqrt(cauchy_weights(lengths, _CAUCHY, _LEAST_MPS2)) / _TRIPLE_MPS2
        # R = exp(delta) R changes the force by the columns hat(e_k) @ R.
        generators = np.stack([(se3.hat(axis) @ R).ravel() for axis in np.eye(3)], axis=1)
        J = np.concatenate([force @ generators, -turned, minus_one], axis=2)
        J = (weight[:, None, None] * J).reshape(-1, 9)
        length = max(float(np.linalg.norm(gravity)), 1e-3)
        prior[6, 6:] = gravity / length
        r_prior = np.array([*rotation_vector(R @ R_given.T), *bias, length - GRAVITY_MPS2])
        weighted = prior / np.square(sigmas)[:, None]
        normal = J.T @ J + weighted.T @ prior
        gradient = J.T @ (weight[:, None] * residual).ravel() + weighted.T @ r_prior
        delta = -np.linalg.solve(normal, gradient)
        R = rotations(delta[:3]) @ R
        bias, gravity = bias + delta[3:6], gravity + delta[6:]
    residual = force @ R.ravel() - turned @ bias - gravity - acceleration
    typical_mps2 = float(np.median(np.linalg.norm(residual, axis=1))) / _MEDIAN_LENGTH
    covariance = max(typical_mps2 / _TRIPLE_MPS2, 1.0) ** 2 * np.linalg.inv(normal)
    across = np.eye(3) - np.outer(gravity, gravity) / (gravity @ gravity)
    up_covariance = across @ covariance[6:, 6:] @ across / GRAVITY_MPS2**2
    sigma_rad, rotation_sigma_rad = (
        float(np.sqrt(np.linalg.eigvalsh(part)[-1]))
        for part in (up_covariance, covariance[:3, :3])
    )
    return Gravity(0, gravity, sigma_rad, R, rotation_sigma_rad, bias)
