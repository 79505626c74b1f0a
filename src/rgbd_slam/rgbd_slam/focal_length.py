"""A check of the configured focal length by pairs of keyframes (decision 045).

With a wrong focal length, no camera motion explains both the shift of the points that two
keyframes share and the change of their depth. The check only reads the map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoid_common import se3
from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera, to_camera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.tracking.rolling_shutter import linearized, normal_matrix

# The numbers up to _LARGEST_STEP are not tuned.
_MIN_SHARED, _MAX_SHARED = 30, 300  # smallest and largest number of points of a pair
_PAIRS = 3  # number of earlier keyframes that a new one is compared with
_ROUNDS = 2  # number of Gauss-Newton steps
_LARGEST_STEP = 0.1  # largest step of the relative focal length
_MIN_KEYFRAMES, _MAX_KEYFRAMES = 20, 200  # number of compared keyframes: for a result, and at most
# The error is reported if an interval of three standard errors is beyond 2 %: correct cameras are
# within 1.4 % (decision 045).
_STANDARD_ERRORS, _TOLERATED = 3.0, 0.02
_PROBLEM = (
    'the focal length seems {:.0f} % too {} ({:.1f} to {:.1f} %): calibrate the camera, and '
    'publish or state its calibration'
)


class FocalLengthCheck:
    """Estimates the error of the focal length as keyframes are mapped."""

    def __init__(self, camera: StereoCamera) -> None:
        self.num_keyframes = 0  # number of keyframes that were compared
        self._camera = camera
        self._newest_uid = -1
        # Of [information, information * error] of each keyframe: the sum, and that of products.
        self._sum, self._products = np.zeros(2), np.zeros((2, 2))

    @property
    def error(self) -> tuple[float, float]:
        """Return by which ratio the focal length is too short, and the standard error of that.

        The standard error follows from the scatter of keyframes. (0, inf): not known yet.
        """
        if self.num_keyframes < _MIN_KEYFRAMES:
            return 0.0, np.inf
        information, weighted = self._sum.tolist()
        error = weighted / information
        scatter = np.array([-error, 1.0])
        return error, float(np.sqrt(scatter @ self._products @ scatter)) / information

    @property
    def problem(self) -> str:
        """Return one line if the focal length is wrong, else ''."""
        error, sigma = self.error
        around = _STANDARD_ERRORS * sigma
        if abs(error) < _TOLERATED + around:
            return ''
        errors = error + np.array([0, -around, around])
        percent = 100 * np.abs(1 / (1 + errors) - 1)
        word = 'long' if error < 0 else 'short'
        return _PROBLEM.format(percent[0], word, *np.sort(percent[1:]))

    def add_newest(self, atlas: Atlas) -> None:
        """Compare the newest mapped keyframe with earlier ones, unless that was done before."""
        keyframes = atlas.keyframes
        i = int(np.argmax(keyframes.uid))
        is_new = keyframes.uid[i] > self._newest_uid and not keyframes.is_loaded[i]
        if not is_new or self.num_keyframes == _MAX_KEYFRAMES:
            return
        self._newest_uid = int(keyframes.uid[i])
        near = atlas.covisible(i, _MIN_SHARED)
        near = near[~keyframes.is_loaded[near]][:: -(-len(near) // _PAIRS) or 1]
        found = sum((self._compare(atlas, j, i) for j in near.tolist()), np.zeros(2))
        if found[0] > 0:
            self.num_keyframes += 1
            self._sum += found
            self._products += np.outer(found, found)

    def _compare(self, atlas: Atlas, j: int, i: int) -> FloatArray:
        """Return the information (1) of two keyframes, and its product with the error."""
        keyframes = atlas.keyframes
        first, second = keyframes.frame(j), keyframes.frame(i)
        k = _shared(first, keyframes.points_of(j), second, keyframes.points_of(i))
        if k.shape[1] < _MIN_SHARED:
            return np.zeros(2)
        T = se3.inverse(keyframes.T_map_camera[i]) @ keyframes.T_map_camera[j]
        return _evidence(self._camera, atlas.octave_scale, first, second, k, T)


def _shared(
    first: Frame, first_points: IntArray, second: Frame, second_points: IntArray
) -> IntArray:
    """Return the (2, N) features of two frames that observe the same points, with depth."""
    k_first, k_second = (
        np.flatnonzero((points != NO_POINT) & frame.has_depth)
        for points, frame in ((first_points, first), (second_points, second))
    )
    _, at_first, at_second = np.intersect1d(
        first_points[k_first], second_points[k_second], return_indices=True
    )
    every = 1 + len(at_first) // _MAX_SHARED
    return np.stack([k_first[at_first[::every]], k_second[at_second[::every]]])


def _evidence(
    camera: StereoCamera,
    octave_scale: FloatArray,
    first: Frame,
    second: Frame,
    k: IntArray,
    T_second_first: FloatArray,
) -> FloatArray:
    """Return the information of a pair about the error, marginal of its motion, and its product.

    Features k (2, N) show the same points. A longer focal length moves a point of the first image,
    whose depth is known, towards the axis, and its projection in the second one outwards.
    """
    T, error, normal = T_second_first, 0.0, np.eye(8)
    measured = second.measurement_px[k[1]].T.astype(np.float64)
    scale = octave_scale[second.octave[k[1]]]
    for _ in range(_ROUNDS):
        lens = replace(camera, fx_px=camera.fx_px * (1 + error), fy_px=camera.fy_px * (1 + error))
        position_m = lens.back_project(first.measurement_px[k[0]], first.depth_m[k[0]]).T
        x = to_camera(T, position_m)
        np.maximum(x[2], MIN_DEPTH_M, out=x[2])
        by_pose, residual = linearized(lens, x, measured, scale)
        by_error = np.einsum('acn,an->cn', by_pose[3:], -T[:3, :2] @ position_m[:2])
        center = np.array([[camera.cx_px], [camera.cy_px]])
        by_error[:2] += (lens.project_rows(x)[:2] - center) / (camera.pixel_noise * scale)
        normal = normal_matrix(by_pose, by_error, residual)
        if np.linalg.matrix_rank(normal[:7, :7]) < 7:
            return np.zeros(2)
        step = np.asarray(np.linalg.solve(normal[:7, :7], normal[:7, 7]), np.float64)
        T = se3.exp(step[:6]) @ T
        error += float(np.clip(step[6], -_LARGEST_STEP, _LARGEST_STEP))
    information = 1 / float(np.linalg.inv(normal[:7, :7])[6, 6])
    return information * np.array([1.0, error])
