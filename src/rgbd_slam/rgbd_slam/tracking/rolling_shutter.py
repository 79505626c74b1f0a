"""A camera that reads its rows one after another: how long that takes, and images without it.

A turning camera's rows are from different poses; where near things are low in the image, as they
mostly are, another turn and another way explain that nearly as well. What they do not explain
tells how long the rows take: one number for all residuals of some seconds.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from hoid_common import se3
from hoid_common.values import Float32Array, FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.projection import MIN_DEPTH_M, to_camera
from rgbd_slam.model.tracked_frame import TrackedFrame

_IMAGES = 10  # in a row that tell one time; where the motion goes on, so do errors of the map
_TIMES = 12  # of which the last are averaged
_MIN_TIMES = 4
_PRIOR_S = 1e-3  # standard deviation of "none", which a camera at rest says nothing against
_LEAST_S = 5e-3  # less is not told from errors of the map, and does no harm
_MOST_S = 0.05
_SURE = 3.0  # standard errors of the average, by how the times scatter
_MOST_MATCHES = 300  # of an image that are looked at
_USUAL_SIGMAS = 2.0  # a residual beyond counts less


class RollingShutter:
    """Measures how long the rows of an image take, and moves features to where all were at once.

    Args:
        height_px: Rows of an image.
    """

    def __init__(self, height_px: int) -> None:
        self.readout_s = 0.0  # from the first row to the last; 0 until that is sure
        self._height_px = height_px
        self._times: deque[tuple[float, float]] = deque(maxlen=_TIMES)  # s, and its information
        self._begin()

    def _begin(self) -> None:
        self._num_images = 0
        self._weighed_s = self._information = 0.0

    def straightened(self, frame: Frame, camera: StereoCamera, twist: FloatArray) -> Frame:
        """Return a frame as if all rows were taken with the middle one.

        Args:
            frame: As imaged.
            camera: Its camera.
            twist: (6,) of points in the camera's frame: rad/s, then m/s.
        """
        if self.readout_s == 0 or not frame.has_depth.any() or not twist.any():
            return frame
        has_depth = frame.has_depth
        depth_m = np.where(has_depth, frame.depth_m, np.median(frame.depth_m[has_depth]))
        x = camera.back_project(frame.measurement_px[:, :2], depth_m).T
        late_s = self.readout_s * self._rows(frame.measurement_px[:, 1])
        x -= late_s * (se3.hat(twist[:3]) @ x + twist[3:, None])
        np.maximum(x[2], MIN_DEPTH_M, out=x[2])
        measurement_px = camera.project_rows(x).T.astype(np.float32, order='C')
        measurement_px[~has_depth, 2] = np.nan
        straight_m = np.where(has_depth, x[2], 0).astype(np.float32)
        return replace(frame, measurement_px=measurement_px, depth_m=straight_m)

    def add(
        self, tracked: TrackedFrame, atlas: Atlas, camera: StereoCamera, twist: FloatArray
    ) -> None:
        """Take what an image's residuals say.

        Args:
            tracked: As tracked, after it was straightened.
            atlas: The map.
            camera: With the noise measured.
            twist: (6,) of points in the camera's frame: rad/s, then m/s.
        """
        k = np.flatnonzero((tracked.points != NO_POINT) & tracked.frame.has_depth)
        k = k[:: 1 + len(k) // _MOST_MATCHES]
        if len(k) == 0:
            return
        position_m = atlas.points.position_m.take(tracked.points[k], 0)
        x = to_camera(se3.inverse(tracked.T_map_camera), position_m.T)
        measured = tracked.frame.measurement_px.take(k, 0).T.astype(np.float64)
        sigma = np.empty((3, len(k)))
        sigma[:2] = camera.pixel_noise * atlas.octave_scale[tracked.frame.octave[k]]
        sigma[2] = camera.disparity_sigma_px(measured[0] - measured[2])
        residual = _with_disparity(measured - camera.project_rows(x)) / sigma
        by_pose = _rates(camera, x) / sigma
        by_time = self._rows(measured[1]) * (twist @ by_pose.reshape(6, -1)).reshape(3, -1)
        told = _apart_from(by_pose, by_time, residual)
        self._information += told[0]
        self._weighed_s += told[1] + self.readout_s * told[0]
        self._num_images += 1
        if self._num_images == _IMAGES:
            self._judge()

    def _judge(self) -> None:
        """End a run of images, and believe the average where it is sure."""
        if self._information > 0:
            self._times.append((self._weighed_s / self._information, self._information))
        self._begin()
        if len(self._times) < _MIN_TIMES:
            return
        times_s, weights = np.array(self._times).T
        total = weights.sum() + _PRIOR_S**-2
        mean_s = float(weights @ times_s / total)
        error_s = float(np.linalg.norm(weights * (times_s - mean_s)) / total)
        is_sure = abs(mean_s) > max(_LEAST_S, _SURE * error_s)
        self.readout_s = float(np.clip(mean_s, -_MOST_S, _MOST_S)) if is_sure else 0.0

    def _rows(self, v_px: Float32Array | FloatArray) -> FloatArray:
        """Return where rows lie, from -0.5 at the top to 0.5."""
        return v_px.astype(np.float64) / self._height_px - 0.5


def _rates(camera: StereoCamera, x: FloatArray) -> FloatArray:
    """Return (6, 3, N): how u, v and disparity of points (3, N) go with each part of a twist."""
    inv_z = 1 / x[2]
    a, b = x[0] * inv_z, x[1] * inv_z
    none, one = np.zeros_like(a), np.ones_like(a)
    u = camera.fx_px * np.stack([-a * b, one + a * a, -b, inv_z, none, -a * inv_z])
    v = camera.fy_px * np.stack([-one - b * b, a * b, a, none, inv_z, -b * inv_z])
    away = np.stack([b, -a, none, none, none, inv_z])
    return np.stack([u, v, -camera.baseline_px_m * inv_z * away], 1)


def _with_disparity(pixels: FloatArray) -> FloatArray:
    """Return (3, N) with u - u_right in place of u_right."""
    return np.stack([pixels[0], pixels[1], pixels[0] - pixels[2]])


def _apart_from(
    by_pose: FloatArray, by_time: FloatArray, residual: FloatArray
) -> tuple[float, float]:
    """Return the information about a time, and that times it, left when the pose takes its share.

    Args:
        by_pose: (6, 3, N) what residuals (3, N) change by with the pose, in standard deviations.
        by_time: (3, N) and with the time.
        residual: (3, N).
    """
    weight = 1 / (1 + np.square(residual / _USUAL_SIGMAS))
    columns = np.concatenate([by_pose, by_time[None], residual[None]]).reshape(8, -1)
    normal = (columns * weight.ravel()) @ columns.T
    if np.linalg.matrix_rank(normal[:6, :6]) < 6:
        return 0.0, 0.0
    left = normal[6:, 6:] - normal[6:, :6] @ np.linalg.solve(normal[:6, :6], normal[:6, 6:])
    return float(left[0, 0]), float(left[0, 1])
