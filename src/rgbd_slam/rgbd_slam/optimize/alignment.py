"""The pose of an image relative to 3-D points, from matches many of which may be wrong.

Both methods are RANSAC (Fischler and Bolles, CACM 1981). With at least 15 depth measurements,
hypotheses align 3-D points in closed form (Horn, JOSA A 1987, by the SVD of Arun et al., PAMI
1987), and all are computed and scored at once. With fewer, they come from pixels alone (PnP).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray
from rgbd_slam.model.frame import Frame, StereoCamera

_SAMPLE = 3  # least number of points that determine a pose (Horn 1987)
# Chosen: number of RANSAC samples of three matches. If 28 % of the matches are right, one sample
# or more has only right ones with a probability of 99 %.
_NUM_HYPOTHESES = 200
# Largest reprojection error of an inlier in octave 0. Not tuned; the 95 % limit of chi-square is
# 2.4 px for a noise of 1 px.
_MAX_ERROR_PX = 4.0
_MIN_INLIERS = 15  # least number of matches that agree with a pose; not tuned
_NUM_REFINED = 5  # number of hypotheses that are refined: those with most inliers
_NUM_REFINEMENTS = 4  # number of iterations of a refinement


class Alignment(NamedTuple):
    """The transform from the frame of matched points to the camera frame of an image."""

    T_camera_points: FloatArray  # (4, 4)
    inliers: BoolArray  # (N,) mask of the matches that agree with the transform


def align_points(
    points_a_m: FloatArray, points_b_m: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """Return T_a_b (..., 4, 4) that maps points b (..., N, 3) onto points a by least squares."""
    w = np.ones(points_a_m.shape[:-1]) if weights is None else weights
    w = (w / w.sum(axis=-1, keepdims=True))[..., None]
    mean_a = (w * points_a_m).sum(axis=-2, keepdims=True)
    mean_b = (w * points_b_m).sum(axis=-2, keepdims=True)
    spread = np.swapaxes(w * (points_a_m - mean_a), -1, -2) @ (points_b_m - mean_b)
    U, _, Vt = np.linalg.svd(spread)
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]  # a rotation, not a reflection
    T = np.zeros((*spread.shape[:-2], 4, 4))
    T[..., :3, :3] = U @ Vt
    T[..., :3, 3] = (mean_a - mean_b @ np.swapaxes(T[..., :3, :3], -1, -2))[..., 0, :]
    T[..., 3, 3] = 1.0
    return T


def align_image(
    frame: Frame,
    k: IntArray,
    points_m: FloatArray,
    octave_scale: FloatArray,
    camera: StereoCamera,
    rng: np.random.Generator,
) -> Alignment | None:
    """Return the pose that most of N matches fit, by RANSAC; None if fewer than 15 fit.

    A match of feature `k[n]` with point n (N, 3) fits if its reprojection error is below 4 px in
    octave 0. `octave_scale` has the pixel size of each octave, in pixels of the image.
    """
    if len(points_m) < _MIN_INLIERS:
        return None
    measurement_px, depth_m = frame.measurement_px[k], frame.depth_m[k]
    limit_px = _MAX_ERROR_PX * octave_scale[frame.octave[k]]
    seen_m = camera.back_project(measurement_px, depth_m)
    with_depth = np.flatnonzero(depth_m > 0)
    if len(with_depth) >= _MIN_INLIERS:
        sample = np.argsort(rng.random((_NUM_HYPOTHESES, len(with_depth))), axis=1)[:, :_SAMPLE]
        hypotheses = align_points(seen_m[with_depth][sample], points_m[with_depth][sample])
    else:
        hypotheses = _pose_from_pixels(measurement_px, points_m, camera)

    def agreeing(T_camera_points: FloatArray) -> BoolArray:
        error_px = _reprojection_error_px(T_camera_points, measurement_px, points_m, camera)
        return error_px < limit_px

    agrees = agreeing(hypotheses)
    leading = np.argsort(-agrees.sum(axis=1), kind='stable')[:_NUM_REFINED]
    best, most = None, _MIN_INLIERS - 1
    for n in leading:
        T, inliers = _refined(hypotheses[n], agrees[n], seen_m, points_m, agreeing)
        if inliers.sum() > most:
            best, most = Alignment(T, inliers), int(inliers.sum())
    return best


def _refined(
    T_camera_points: FloatArray,
    inliers: BoolArray,
    seen_m: FloatArray,
    points_m: FloatArray,
    agreeing: Callable[[FloatArray], BoolArray],
) -> tuple[FloatArray, BoolArray]:
    """Refine a pose hypothesis; return the pose with most inliers, and their mask (N,).

    The pose is aligned to its inliers with depth in up to four iterations, because a pose of three
    points alone carries much noise (LO-RANSAC: Chum, Matas and Kittler, DAGM 2003).
    """
    best, most = T_camera_points, inliers
    for _ in range(_NUM_REFINEMENTS):
        use = inliers & (seen_m[:, 2] > 0)
        if use.sum() <= _SAMPLE:
            break
        T = align_points(seen_m[use], points_m[use], seen_m[use, 2] ** -2)
        inliers = agreeing(T[None])[0]
        if inliers.sum() > most.sum():
            best, most = T, inliers
    return best, most


def _pose_from_pixels(
    measurement_px: Float32Array, points_m: FloatArray, camera: StereoCamera
) -> FloatArray:
    """Return T_camera_points (1, 4, 4) by OpenCV's PnP with RANSAC; (0, 4, 4): no pose."""
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    try:
        found, rotation, translation, _ = cv2.solvePnPRansac(
            points_m,
            measurement_px[:, :2].astype(np.float64),
            K,
            np.zeros(4),
            iterationsCount=_NUM_HYPOTHESES,
            reprojectionError=_MAX_ERROR_PX,
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:  # SQPnP fails an assertion on samples that determine no pose
        found = False
    if not found:
        return np.empty((0, 4, 4))
    T = np.eye(4)[None]
    T[0, :3, :3] = cv2.Rodrigues(rotation)[0]
    T[0, :3, 3] = translation.ravel()
    return T


def _reprojection_error_px(
    T_camera_points: FloatArray,
    measurement_px: Float32Array,
    points_m: FloatArray,
    camera: StereoCamera,
) -> FloatArray:
    """Return the reprojection errors (H, N) in px of N points for H poses.

    An error is the distance in (u, v, u_right), or in (u, v) without depth; inf behind the camera.
    """
    p = points_m @ np.swapaxes(T_camera_points[:, :3, :3], 1, 2) + T_camera_points[:, None, :3, 3]
    in_front = p[..., 2] > 0
    p[..., 2] = np.where(in_front, p[..., 2], 1.0)
    difference = camera.project(p.reshape(-1, 3)).reshape(p.shape) - measurement_px
    error = np.sqrt(np.nansum(difference**2, axis=2))
    return np.where(in_front, error, np.inf)
