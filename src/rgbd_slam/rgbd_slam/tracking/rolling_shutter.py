"""Estimation and compensation of a rolling shutter (decision 033).

The rows of an image are read one after another, which displaces the features if the camera moves.
A wrong pose explains most of the displacement. The rest depends on the row and is proportional to
the readout time, which is estimated from the residuals of several seconds.

Without a gyro, these are the residuals of map points. But a map made from displaced features
agrees with them in fast turns, so that residuals show only a small part of the readout time. With
a gyro, the velocity at each image is accurate enough to compare images with each other instead.

An image with more rows than columns was rotated by the driver: its columns are the sensor's rows.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.io.depth import MAX_DEPTH_M, MIN_DEPTH_M
from hoid_common.values import NS_PER_S, Float32Array, FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera, to_camera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.optimize.measured_noise import median

# Number of successive images that give one estimate; estimates of single images would not be
# independent, because map errors are the same in all images of one motion. Not tuned, nor are the
# other numbers without a source.
_IMAGES_PER_ESTIMATE = 10
# Number of successive pairs of images that give one estimate; pairs depend less on the map.
_PAIRS_PER_ESTIMATE = 5
_MAX_ESTIMATES = 12  # number of latest estimates that are averaged
# The same for pairs of images. The newest are best, because they were matched after compensation
# by the present readout time.
_MAX_ESTIMATES_OF_PAIRS = 8
_MIN_ESTIMATES = 4  # with fewer estimates, the readout time counts as 0
# Standard deviation of a prior readout time of 0, which dominates while the camera is at rest.
_PRIOR_S = 1e-3
_MIN_READOUT_S = 5e-3  # errors of map points look like a readout of 1 to 4 ms (decision 033)
_MAX_READOUT_S = 0.05  # chosen: the time between images at 20 Hz
# The average is significant if it is at least this multiple of its standard error, which follows
# from the scatter of the estimates (decision 033).
_MIN_STANDARD_ERRORS = 3.0
_MAX_MATCHES = 300  # largest number of matches that are used per image
# Scale of the robust weights in standard deviations (2.385 has 95 % efficiency).
_CAUCHY_SCALE = 2.0
_APART = 2  # chosen: number of images from the first to the second of a pair
_MIN_MATCHES = 30  # chosen: least number of matches of a pair
_MAX_APART_NS = NS_PER_S // 5  # chosen: images with a longer time between them are not compared
_OF_PAIR = 2**0.5  # factor on the standard deviation for the difference of two measurements


class MovingView(NamedTuple):
    """A tracked image, compensated before tracking, and the velocity of the camera."""

    tracked: TrackedFrame
    matched: IntArray  # (N,) map point matched with each feature, or NO_POINT; outliers included
    T_odom_camera: FloatArray  # (4, 4)
    # (6,) velocity of points in the camera frame, rotation first (rad/s, m/s).
    twist: FloatArray
    is_measured: bool  # whether a gyro has measured the rotation of `twist`


class RollingShutter:
    """Estimates the readout time of images, and compensates features to the middle row's time."""

    def __init__(self, width_px: int, height_px: int) -> None:
        # Time (s) from the first row to the last, negative if the last row is read first; 0 while
        # it is not significant.
        self.readout_s = 0.0
        self._is_turned = height_px > width_px
        self._num_rows = min(width_px, height_px)
        # Estimates of the readout time (s), each with its information (1/s^2).
        self._estimates: deque[tuple[float, float]] = deque(maxlen=_MAX_ESTIMATES)
        # The latest images, if a gyro has measured their rotation.
        self._views: deque[MovingView] = deque(maxlen=_APART + 1)
        self._compares_pairs = False
        self._begin()

    def _begin(self) -> None:
        self._num_images = 0
        self._weighted_s = self._information = 0.0

    def compensated(self, frame: Frame, camera: StereoCamera, twist: FloatArray) -> Frame:
        """Return the undistorted frame as if all rows had been exposed with the middle row.

        `twist` (6,) is that of points in the camera frame, rotation first (rad/s, m/s). Features
        without depth are assumed at the median depth. The frame is not changed if no readout time
        is known, no feature has depth, or the camera is at rest.
        """
        if self.readout_s == 0 or not frame.has_depth.any() or not twist.any():
            return frame
        has_depth = frame.has_depth
        depth_m = np.where(has_depth, frame.depth_m, median(frame.depth_m[has_depth]))
        x = camera.back_project(frame.measurement_px[:, :2], depth_m).T
        delay_s = self.readout_s * self._rows(frame.measurement_px.T)
        x -= delay_s * (se3.hat(twist[:3]) @ x + twist[3:, None])
        np.clip(x[2], MIN_DEPTH_M, MAX_DEPTH_M, out=x[2])
        measurement_px = camera.project_rows(x).T.astype(np.float32, order='C')
        measurement_px[~has_depth, 2] = np.nan
        compensated_m = np.where(has_depth, x[2], 0).astype(np.float32)
        return replace(frame, measurement_px=measurement_px, depth_m=compensated_m)

    def add(self, view: MovingView, atlas: Atlas, camera: StereoCamera) -> None:
        """Update the estimate of the readout time by a tracked image.

        Without a gyro, the residuals of points with depth are used. Once a gyro has measured the
        rotation of an image, only such images are used, each compared with that two images before.
        """
        if view.is_measured:
            self._add_pair(view, camera, atlas.octave_scale)
        elif not self._compares_pairs:
            self._add_residuals(view, atlas, camera)

    def _add_residuals(self, view: MovingView, atlas: Atlas, camera: StereoCamera) -> None:
        tracked = view.tracked
        k = np.flatnonzero((tracked.points != NO_POINT) & tracked.frame.has_depth)
        k = k[:: 1 + len(k) // _MAX_MATCHES]
        if len(k) == 0:
            return
        position_m = atlas.points.position_m.take(tracked.points[k], 0)
        x = to_camera(se3.inverse(tracked.T_map_camera), position_m.T)
        measured = tracked.frame.measurement_px.take(k, 0).T.astype(np.float64)
        scale = atlas.octave_scale[tracked.frame.octave[k]]
        by_pose, residual = linearized(camera, x, measured, scale)
        by_twist = (view.twist @ by_pose.reshape(6, -1)).reshape(3, -1)
        by_time = self._rows(measured) * by_twist
        information, weighted_s = _marginal_of_time(by_pose, by_time, residual)
        self._count(information, weighted_s, _IMAGES_PER_ESTIMATE)

    def _add_pair(self, view: MovingView, camera: StereoCamera, octave_scale: FloatArray) -> None:
        if not self._compares_pairs:
            self._compares_pairs = True
            self._estimates = deque(maxlen=_MAX_ESTIMATES_OF_PAIRS)
            self._begin()
        stamp_ns = view.tracked.frame.stamp_ns
        if self._views and stamp_ns <= self._views[-1].tracked.frame.stamp_ns:
            self._views.clear()
        self._views.append(view)
        first = self._views[0]
        apart_ns = stamp_ns - first.tracked.frame.stamp_ns
        if len(self._views) == _APART + 1 and apart_ns <= _MAX_APART_NS:
            compared = self._compare(first, view, camera, octave_scale)
            self._count(*compared, _PAIRS_PER_ESTIMATE)

    def _compare(
        self, first: MovingView, second: MovingView, camera: StereoCamera, scale: FloatArray
    ) -> tuple[float, float]:
        """Return the evidence of two images for the readout time (`_marginal_of_time`).

        Pixel and depth in the first image predict where the second one shows a point. A rolling
        shutter displaces it from there if the velocity of the camera or the row of the point has
        changed. Outliers of the poses are used too, because displaced features do not fit.
        """
        k_first, k_second = _common(first, second)
        if len(k_first) < _MIN_MATCHES:
            return 0.0, 0.0
        T_second_first = se3.inverse(second.T_odom_camera) @ first.T_odom_camera
        before, after = first.tracked.frame, second.tracked.frame
        before_px = before.measurement_px[k_first]
        position_m = camera.back_project(before_px[:, :2], before.depth_m[k_first])
        x = to_camera(T_second_first, position_m.T)
        np.maximum(x[2], MIN_DEPTH_M, out=x[2])
        measured = after.measurement_px[k_second].T.astype(np.float64)
        found = linearized(camera, x, measured, scale[after.octave[k_second]])
        by_pose, residual = (value / _OF_PAIR for value in found)
        twists = np.stack([second.twist, se3.adjoint(T_second_first) @ first.twist])
        by_twist = (twists @ by_pose.reshape(6, -1)).reshape(2, 3, -1)
        by_time = self._rows(measured) * by_twist[0] - self._rows(before_px.T) * by_twist[1]
        return _marginal_of_time(by_pose, by_time, residual)

    def _count(self, information: float, weighted_s: float, num_images: int) -> None:
        self._information += information
        self._weighted_s += weighted_s + self.readout_s * information
        self._num_images += 1
        if self._num_images == num_images:
            self._update()

    def _update(self) -> None:
        """Add the estimate of the last images; use the average if significant, else 0."""
        if self._information > 0:
            self._estimates.append((self._weighted_s / self._information, self._information))
        self._begin()
        if len(self._estimates) < _MIN_ESTIMATES:
            return
        times_s, weights = np.array(self._estimates).T
        total = weights.sum() + _PRIOR_S**-2
        mean_s = float(weights @ times_s / total)
        error_s = float(np.linalg.norm(weights * (times_s - mean_s)) / total)
        is_significant = abs(mean_s) > max(_MIN_READOUT_S, _MIN_STANDARD_ERRORS * error_s)
        self.readout_s = (
            float(np.clip(mean_s, -_MAX_READOUT_S, _MAX_READOUT_S)) if is_significant else 0.0
        )

    def _rows(self, measured_px: Float32Array | FloatArray) -> FloatArray:
        """Return the sensor rows (N,) of pixels (3, N) u, v, u_right, as -0.5 (first) to 0.5."""
        row_px = measured_px[0 if self._is_turned else 1]
        return np.asarray(row_px, np.float64) / self._num_rows - 0.5


def _common(first: MovingView, second: MovingView) -> tuple[IntArray, IntArray]:
    """Return up to 300 features (M,) of each image that are matched with the same map points."""
    k_first, k_second = (
        np.flatnonzero((view.matched != NO_POINT) & view.tracked.frame.has_depth)
        for view in (first, second)
    )
    _, at_first, at_second = np.intersect1d(
        first.matched[k_first], second.matched[k_second], return_indices=True
    )
    every = 1 + len(at_first) // _MAX_MATCHES
    return k_first[at_first[::every]], k_second[at_second[::every]]


def linearized(
    camera: StereoCamera, x: FloatArray, measured_px: FloatArray, scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives (6, 3, N) and residuals (3, N) of u, v and disparity.

    Both are divided by the standard deviations of a measurement, which grow with the pixel size
    `scale` (N,) of the feature's octave. Derivatives are by a twist that moves the points (3, N).
    """
    sigma = np.empty((3, len(scale)))
    sigma[:2] = camera.pixel_noise * scale
    sigma[2] = camera.disparity_sigma_px(measured_px[0] - measured_px[2])
    residual = _with_disparity(measured_px - camera.project_rows(x)) / sigma
    return _pose_derivatives(camera, x) / sigma, residual


def _pose_derivatives(camera: StereoCamera, x: FloatArray) -> FloatArray:
    """Return derivatives (6, 3, N) of u, v and disparity (px) of points (3, N) by a twist."""
    inv_z = 1 / x[2]
    a, b = x[0] * inv_z, x[1] * inv_z
    zero, one = np.zeros_like(a), np.ones_like(a)
    u = camera.fx_px * np.stack([-a * b, one + a * a, -b, inv_z, zero, -a * inv_z])
    v = camera.fy_px * np.stack([-one - b * b, a * b, a, zero, inv_z, -b * inv_z])
    depth_rate = np.stack([b, -a, zero, zero, zero, inv_z])
    return np.stack([u, v, -camera.baseline_px_m * inv_z * depth_rate], 1)


def _with_disparity(pixels: FloatArray) -> FloatArray:
    return np.stack([pixels[0], pixels[1], pixels[0] - pixels[2]])


def _marginal_of_time(
    by_pose: FloatArray, by_time: FloatArray, residual: FloatArray
) -> tuple[float, float]:
    """Return the information (1/s^2) about the readout time, and its product with this time (1/s).

    The readout time is that which explains the normalized residuals (3, N) best. The pose is
    marginalized out by the Schur complement, with robust weights (Cauchy). Both are 0 if the pose
    is not determined.
    """
    normal = normal_matrix(by_pose, by_time, residual)
    if np.linalg.matrix_rank(normal[:6, :6]) < 6:
        return 0.0, 0.0
    left = normal[6:, 6:] - normal[6:, :6] @ np.linalg.solve(normal[:6, :6], normal[:6, 6:])
    return float(left[0, 0]), float(left[0, 1])


def normal_matrix(by_pose: FloatArray, by_more: FloatArray, residual: FloatArray) -> FloatArray:
    """Return the (8, 8) normal matrix of six parameters, one more, and the residuals (3, N).

    The derivatives are those of `linearized`; the weights are robust (Cauchy).
    """
    weight = 1 / (1 + np.square(residual / _CAUCHY_SCALE))
    columns = np.concatenate([by_pose, by_more[None], residual[None]]).reshape(8, -1)
    return np.asarray((columns * weight.ravel()) @ columns.T)
