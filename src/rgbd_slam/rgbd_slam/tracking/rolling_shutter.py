"""Estimation and compensation of a rolling shutter (decision 033).

The rows of an image are read one after another, which displaces the features of a moving camera. A
wrong pose explains most of that displacement. The rest depends on the row and is proportional to
the readout time, which is estimated from pairs of images with different velocities.

An image with more rows than columns was rotated by its driver: its columns are the sensor's rows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.io.depth import MAX_DEPTH_M, MIN_DEPTH_M
from hoid_common.values import NS_PER_S, S_PER_NS, Float32Array, FloatArray, IntArray
from rgbd_slam.model.frame import Frame, StereoCamera, to_camera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.optimize.measured_noise import median

# Not tuned, except where another source is named.
# Chosen: standard error [s] of an estimate, which follows from as many pairs as it needs, one in a
# fast turn. A camera at rest therefore changes nothing.
_ESTIMATE_S = 3e-3
_MAX_ESTIMATES = 60  # number of the latest estimates, which are averaged
# Chosen: with so many estimates, which a fast turn gives in half a second, only one image of four
# is compared from then on. This saves 1 ms per image.
_MANY_ESTIMATES, _RARELY = 10, 4
_MIN_ESTIMATES = 5  # number of estimates before which the readout time counts as 0
_MIN_READOUT_S = 5e-3  # decision 033: errors of map points look like a readout of 1 to 4 ms
_MAX_READOUT_S = 0.05  # chosen: the interval of images at 20 Hz
# Decision 033: the average is significant from this multiple of its standard error, which follows
# from the scatter of the estimates. Chosen: it stays so until it is below half of that.
_MIN_STANDARD_ERRORS = 4.0
_MAX_MATCHES = 300  # largest number of matches of an image that are used
_CAUCHY_SCALE = 2.0  # of the robust weights, in standard deviations (95 % efficiency: 2.385)
_ROUNDS = 5  # chosen: rounds of robust weights
# Chosen: images from the first to the second one of a pair. In fast turns, images farther apart
# have few points in common; in slow motion, nearer ones have the same velocity.
_APART = 2, 5
_MIN_MATCHES = 30  # chosen: number of matches that a pair needs
_MAX_APART_NS = NS_PER_S // 2  # chosen: images that span a longer time are not compared
_OF_PAIR = 2**0.5  # factor of the standard deviation of the difference of two measurements


class MovingView(NamedTuple):
    """A tracked image as it was exposed, and the motion of its camera."""

    exposed: Frame  # not compensated
    matched: IntArray  # (N,) map point matched with each feature, outliers included, or NO_POINT
    T_odom_camera: FloatArray  # (4, 4)
    rate_radps: FloatArray | None  # (3,) rotation of the camera, if a gyro has measured it


class RollingShutter:
    """Estimates the readout time of an image, and moves features to the time of its middle row."""

    def __init__(self, width_px: int, height_px: int) -> None:
        # Time from the first row to the last, negative if the last one is read first; 0 as long as
        # it is not significant.
        self.readout_s = 0.0
        self._is_turned = height_px > width_px
        self._num_rows = min(width_px, height_px)
        self._estimates_s: deque[float] = deque(maxlen=_MAX_ESTIMATES)
        # The latest images: those of a pair, with one before and one after it.
        self._views: deque[MovingView] = deque(maxlen=max(_APART) + 3)
        self._num_views = 0
        # Evidence of the pairs since the last estimate.
        self._weighted_s = self._information = 0.0

    def compensated(self, frame: Frame, camera: StereoCamera, twist: FloatArray) -> Frame:
        """Return the undistorted frame as if all rows had been exposed with the middle row.

        The twist (6,) is that of points in the camera frame, rotation first [rad/s, m/s]. Features
        without depth are assumed at the median depth. The frame is returned as it is if no readout
        time is known, no feature has depth, or the camera is at rest.
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

    def add(self, view: MovingView, camera: StereoCamera, octave_scale: FloatArray) -> None:
        """Update the estimated readout time with a tracked image."""
        views = self._views
        if views and view.exposed.stamp_ns <= views[-1].exposed.stamp_ns:
            views.clear()
        views.append(view)
        self._num_views += 1
        if len(self._estimates_s) >= _MANY_ESTIMATES and self._num_views % _RARELY:
            return
        latest = [list(views)[-apart - 3 :] for apart in _APART if len(views) >= apart + 3]
        evidence = [self._compare(part, camera, octave_scale) for part in latest]
        information, weighted_s = max(evidence, default=(0.0, 0.0))
        self._information += information
        self._weighted_s += weighted_s
        if self._information >= _ESTIMATE_S**-2:
            self._update()

    def _compare(
        self, views: Sequence[MovingView], camera: StereoCamera, octave_scale: FloatArray
    ) -> tuple[float, float]:
        """Compare the second of successive views with the last but one by `_marginal_of_time`.

        The first image and its depth predict where the second one shows a point. A rolling shutter
        displaces the point from there if the velocity of the camera or the row of the point has
        changed. Matches that do not fit the poses are compared as well, because displaced features
        do not fit.
        """
        first, second = views[1], views[-2]
        k_first, k_second = _common(first, second)
        apart_ns = views[-1].exposed.stamp_ns - views[0].exposed.stamp_ns
        if len(k_first) < _MIN_MATCHES or apart_ns > _MAX_APART_NS:
            return 0.0, 0.0
        T_second_first = se3.inverse(second.T_odom_camera) @ first.T_odom_camera
        before, after = first.exposed, second.exposed
        before_px = before.measurement_px[k_first]
        position_m = camera.back_project(before_px[:, :2], before.depth_m[k_first])
        x = to_camera(T_second_first, position_m.T)
        np.maximum(x[2], MIN_DEPTH_M, out=x[2])
        measured = after.measurement_px[k_second].T.astype(np.float64)
        scale = octave_scale[after.octave[k_second]]
        by_pose, residual = (v / _OF_PAIR for v in linearized(camera, x, measured, scale))
        twists = np.stack([_twist(*views[-3:]), se3.adjoint(T_second_first) @ _twist(*views[:3])])
        by_twist = (twists @ by_pose.reshape(6, -1)).reshape(2, 3, -1)
        by_time = self._rows(measured) * by_twist[0] - self._rows(before_px.T) * by_twist[1]
        return _marginal_of_time(by_pose, by_time, residual)

    def _update(self) -> None:
        """Add the estimate of the last pairs; use the average if it is significant, else 0."""
        self._estimates_s.append(self._weighted_s / self._information)
        self._weighted_s = self._information = 0.0
        count = len(self._estimates_s)
        if count < _MIN_ESTIMATES:
            return
        mean_s = float(np.mean(self._estimates_s))
        error_s = float(np.std(self._estimates_s, ddof=1)) / count**0.5
        least_s = _MIN_STANDARD_ERRORS * error_s / (2 if self.readout_s else 1)
        is_significant = abs(mean_s) > max(_MIN_READOUT_S, least_s)
        self.readout_s = (
            float(np.clip(mean_s, -_MAX_READOUT_S, _MAX_READOUT_S)) if is_significant else 0.0
        )

    def _rows(self, measured_px: Float32Array | FloatArray) -> FloatArray:
        """Return the (N,) sensor rows of pixels (3, N) u, v, u_right, from -0.5 (first) to 0.5."""
        row_px = measured_px[0 if self._is_turned else 1]
        return np.asarray(row_px, np.float64) / self._num_rows - 0.5


def _twist(before: MovingView, view: MovingView, after: MovingView) -> FloatArray:
    """Return the (6,) velocity of points in the camera frame of a view, rotation first."""
    moved = se3.log(se3.inverse(after.T_odom_camera) @ before.T_odom_camera)
    twist = moved / (S_PER_NS * (after.exposed.stamp_ns - before.exposed.stamp_ns))
    if view.rate_radps is not None:
        twist[:3] = -view.rate_radps
    return np.asarray(twist)


def _common(first: MovingView, second: MovingView) -> tuple[IntArray, IntArray]:
    """Return at most 300 features (M,) of each image that are matched with the same points."""
    k_first, k_second = (
        np.flatnonzero((view.matched != NO_POINT) & view.exposed.has_depth)
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
    """Return the derivatives (6, 3, N) and residuals (3, N) of u, v and disparity of points.

    Both are divided by the standard deviations of a measurement, which grow with the size (N,) of
    a pixel of the feature's octave. The derivatives are by a twist that moves the points (3, N).
    """
    sigma = np.empty((3, len(scale)))
    sigma[:2] = camera.pixel_noise * scale
    sigma[2] = camera.disparity_sigma_px(measured_px[0] - measured_px[2])
    residual = _with_disparity(measured_px - camera.project_rows(x)) / sigma
    return _pose_derivatives(camera, x) / sigma, residual


def _pose_derivatives(camera: StereoCamera, x: FloatArray) -> FloatArray:
    """Return the (6, 3, N) derivatives of u, v and disparity [px] of points (3, N) by a twist."""
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
    """Return the information [1/s^2] about a readout time, and its product with this time [1/s].

    The time explains the normalized residuals (3, N), together with a correction of the pose, by a
    robust fit (Cauchy). Both results are 0 if the pose is not determined.
    """
    fit: FloatArray = np.zeros(7)
    left = np.zeros((2, 2))
    for n in range(_ROUNDS):
        normal = normal_matrix(by_pose, by_time, residual, fit)
        if n == 0 and np.linalg.matrix_rank(normal[:6, :6]) < 6:
            return 0.0, 0.0
        solved = np.linalg.solve(normal[:6, :6], normal[:6, 6:])
        left = normal[6:, 6:] - normal[6:, :6] @ solved
        if left[0, 0] <= 0:
            return 0.0, 0.0
        time_s = left[0, 1] / left[0, 0]
        fit = np.append(solved[:, 1] - time_s * solved[:, 0], time_s)
    return float(left[0, 0]), float(left[0, 1])


def normal_matrix(
    by_pose: FloatArray, by_more: FloatArray, residual: FloatArray, fit: FloatArray | None = None
) -> FloatArray:
    """Return the (8, 8) normal matrix of six parameters, one more, and the residuals (3, N).

    The derivatives are those of `linearized`. The weights are robust (Cauchy): by the residuals
    that a `fit` (7,) leaves.
    """
    columns = np.concatenate([by_pose, by_more[None], residual[None]]).reshape(8, -1)
    left = columns[7] if fit is None else columns[7] - fit @ columns[:7]
    weight = 1 / (1 + np.square(left / _CAUCHY_SCALE))
    return np.asarray((columns * weight) @ columns.T)
