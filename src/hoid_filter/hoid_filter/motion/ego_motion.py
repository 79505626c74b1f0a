"""The camera pose that explains most of the image area, from points of which some move."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from hoid_filter.motion.downscaled_camera import DownscaledCamera
from hoid_native import Gates, StereoParams, align_triples, optimize_pose, score_poses

MIN_POINTS = 10  # chosen: a pose has 6 unknowns, and a point gives 2 or 3 equations
_DISPARITY_NOISE_PX = 0.2  # chosen: standard deviation of the disparity, in gray-image pixels
_GATE_SIGMAS = 3.0  # inlier limit: 99.7 % of a normal distribution
_GATES = Gates(_GATE_SIGMAS**2, _GATE_SIGMAS**2)
_MIN_NOISE_PX, _MAX_NOISE_PX = 0.25, 0.8  # chosen: limits of the estimated noise
# Ratio of the standard deviation to the median of the residuals. It is 0.85 for a 2-D normal
# distribution; chosen higher because residuals of tracked points have a heavy tail.
_NOISE_PER_MEDIAN = 1.3
_NOISE_GAIN = 0.1  # chosen: the noise estimate averages over about 10 images
_REFINE_FACTOR = 1.5  # chosen: points within 1.5 times the inlier limit are used to refine a pose
# Chosen: if a pose explains a larger ratio of the area, no other hypotheses are tried.
_SUFFICIENT_RATIO = 0.92
# Chosen: number of regions that yield a pose hypothesis, and least number of points of such a
# region.
_MAX_REGION_HYPOTHESES, _MIN_REGION_POINTS = 4, 8
# Number of RANSAC samples of three points. If half of the points are static, the probability that
# every sample contains a moving point is 1.4 %.
_NUM_SAMPLES = 32
# Chosen: the best pose without the prior is used instead of the best one with it only if it
# explains this much more of the area. In a trial without this comparison, a wrong prior confirmed
# itself in one of four runs.
_SWITCH_RATIO = 0.15
# Chosen: depth decides between the best pose and another one only if the other explains at least
# this ratio of the area in addition.
_MIN_RIVAL_RATIO = 0.12
# Chosen: depth decides for the other pose if it makes less of the image contradict earlier depth,
# by 1 % of the image and by a factor of 0.6.
_LESS_CONTRADICTION, _CONTRADICTION_RATIO = 0.01, 0.6


class PointObservations(NamedTuple):
    """N points with a known world position, as observed in one image."""

    world_m: FloatArray  # (N, 3)
    observed_px: FloatArray  # (N, 3) u, v, u_right in gray-image pixels; NaN u_right: no depth
    camera_m: FloatArray  # (N, 3) observed position in the camera frame; 0 without depth
    has_depth: BoolArray  # (N,)
    region: IntArray  # (N,) index of the region of smooth depth with the point; -1 = none
    static_probability: FloatArray  # (N,) prior from earlier images
    # (N, 2) weight of each point: image area that it represents times its depth; in column 0 also
    # times `static_probability`.
    weights: FloatArray

    def select(self, mask: BoolArray) -> PointObservations:
        return PointObservations._make(values[mask] for values in self)


class EgoMotionEstimate(NamedTuple):
    """A camera pose, and the ratio of the image area that it explains."""

    T_camera_world: FloatArray  # (4, 4)
    # Mean of 1 - (residual / inlier limit)^2 over all points, weighted by column 1 of their
    # `weights`; outliers count as 0. In [0, 1].
    ratio: float
    # Whether the pose was chosen although the prior probabilities of being static favor another.
    contradicts_prior: bool


class EgoMotion:
    """Estimates the camera pose that explains most of the image area, not most of the points."""

    def __init__(self, camera: DownscaledCamera) -> None:
        self._camera = camera
        self._random = np.random.default_rng(0)
        # Standard deviation of the tracked pixels of static points, in the gray image.
        self.noise_px = _MAX_NOISE_PX

    def update_noise(self, residuals_px: FloatArray) -> None:
        """Update `noise_px` with reprojection errors (N,) of mostly static points, at least 10."""
        if len(residuals_px) < MIN_POINTS:
            return
        middle = len(residuals_px) // 2
        median_px = float(np.partition(residuals_px, middle)[middle])
        now_px = min(max(_NOISE_PER_MEDIAN * median_px, _MIN_NOISE_PX), _MAX_NOISE_PX)
        self.noise_px += _NOISE_GAIN * (now_px - self.noise_px)

    def estimate(
        self,
        points: PointObservations,
        guesses: list[FloatArray],
        contradiction: Callable[[FloatArray], float] | None = None,
    ) -> EgoMotionEstimate:
        """Return the camera pose that explains most of the static image area.

        Area is weighted by its prior probability of being static. A wrong prior would confirm
        itself; therefore the best pose without the prior is used if it explains clearly more.

        If another pose explains much of the rest of the area, depth decides. A moving picture on a
        large screen, for instance, may explain more area than the room, but at its pose surfaces
        of the room would have moved in front of earlier depth.

        `guesses` are predicted poses T_camera_world (4, 4), the most probable first.
        `contradiction` returns the ratio of the image that contradicts earlier depth at a pose;
        None: depth does not decide.
        """
        is_static = points.static_probability > 0.5
        if np.count_nonzero(is_static) < _MIN_REGION_POINTS:
            is_static = np.ones_like(is_static)
        poses = [*guesses, self._fit(points, is_static, guesses[0])]
        ratios = self._explained_ratios(points, poses)
        if ratios[:, 1].max() >= _SUFFICIENT_RATIO:
            return self._refine_best(points, poses, ratios, 0)
        poses += self._hypotheses(points, guesses[0])
        best = self._best(points, poses)
        rival = None if contradiction is None else self._rival(points, poses, best)
        if rival is None or contradiction is None:
            return best
        of_rival, of_best = (contradiction(pose.T_camera_world) for pose in (rival, best))
        is_clear = of_best - of_rival > _LESS_CONTRADICTION
        return rival if is_clear and of_rival < _CONTRADICTION_RATIO * of_best else best

    def _best(self, points: PointObservations, poses: list[FloatArray]) -> EgoMotionEstimate:
        ratios = self._explained_ratios(points, poses)
        with_prior = self._refine_best(points, poses, ratios, 0)
        if ratios[:, 1].max() <= with_prior.ratio:
            return with_prior
        without_prior = self._refine_best(points, poses, ratios, 1)
        if without_prior.ratio > with_prior.ratio + _SWITCH_RATIO:
            return without_prior._replace(contradicts_prior=True)
        return with_prior

    def _rival(
        self, points: PointObservations, poses: list[FloatArray], best: EgoMotionEstimate
    ) -> EgoMotionEstimate | None:
        """Return the pose fitted to the area that `best` leaves unexplained; None below 12 %."""
        gate_px = _GATE_SIGMAS * self.noise_px
        is_left = self.residuals_px(points, best.T_camera_world) >= gate_px
        area = points.weights[is_left, 1]
        all_area = max(float(points.weights[:, 1].sum()), 1e-9)
        if area.sum() < _MIN_RIVAL_RATIO * all_area:
            return None
        left = points.select(is_left)
        own = (self._all_residuals_px(left, np.array(poses)) < gate_px) @ area
        k = int(np.argmax(own))
        if own[k] < _MIN_RIVAL_RATIO * all_area:
            return None
        near = self.residuals_px(points, poses[k]) < _REFINE_FACTOR * gate_px
        T = self._fit(points, near & is_left, poses[k])
        ratio = float(self._explained_ratios(points, [T])[0, 1])
        return EgoMotionEstimate(T, ratio, contradicts_prior=True)

    def residuals_px(self, points: PointObservations, T_camera_world: FloatArray) -> FloatArray:
        """Return the reprojection errors (N,) at a pose, in pixels of the gray image."""
        return self._errors_px(points, se3.transform(T_camera_world, points.world_m).T)

    def _all_residuals_px(self, points: PointObservations, poses: FloatArray) -> FloatArray:
        """Return the reprojection errors (M, N) at poses T_camera_world (M, 4, 4)."""
        camera_m = poses[:, :3, :3] @ points.world_m.T + poses[:, :3, 3:]
        return self._errors_px(points, np.moveaxis(camera_m, 1, 0))

    def _errors_px(self, points: PointObservations, camera_m: FloatArray) -> FloatArray:
        """Return the reprojection errors (..., N) of points at camera positions (3, ..., N)."""
        pinhole = self._camera.gray_pinhole
        x, y, z = camera_m
        inverse_z = 1 / np.maximum(z, 1e-3)
        du = x * inverse_z * pinhole.fx_px + pinhole.cx_px - points.observed_px[:, 0]
        dv = y * inverse_z * pinhole.fy_px + pinhole.cy_px - points.observed_px[:, 1]
        errors_px: FloatArray = np.hypot(du, dv)
        return errors_px

    def _hypotheses(self, points: PointObservations, guess: FloatArray) -> list[FloatArray]:
        """Return poses (4, 4) fitted to the largest smooth regions and to random samples."""
        counts = np.bincount(points.region + 1)[1:]
        largest = np.argsort(-counts, kind='stable')[:_MAX_REGION_HYPOTHESES]
        enough = largest[counts[largest] >= _MIN_REGION_POINTS]
        poses = [self._fit(points, points.region == region, guess) for region in enough]
        known = np.flatnonzero(points.has_depth)
        if len(known) >= MIN_POINTS:
            triples = known[self._random.integers(0, len(known), (_NUM_SAMPLES, 3))]
            poses += list(align_triples(points.world_m, points.camera_m, triples))
        return poses

    def _refine_best(
        self, points: PointObservations, poses: list[FloatArray], ratios: FloatArray, column: int
    ) -> EgoMotionEstimate:
        """Return the best pose by a column of `_explained_ratios`, refined with its inliers."""
        T = poses[int(ratios[:, column].argmax())]
        errors_px = self.residuals_px(points, T)
        near = errors_px < _REFINE_FACTOR * _GATE_SIGMAS * self.noise_px
        refined = self._fit(points, near, T) if np.count_nonzero(near) >= MIN_POINTS else T
        both = self._explained_ratios(points, [refined, T])
        k = int(both[:, column].argmax())
        return EgoMotionEstimate((refined, T)[k], float(both[k, 1]), contradicts_prior=False)

    def _explained_ratios(self, points: PointObservations, poses: list[FloatArray]) -> FloatArray:
        """Return the ratio (M, 2) of area that each pose explains; column 0 uses the prior."""
        scores = score_poses(
            self._stereo(),
            self.noise_px,
            _GATE_SIGMAS,
            np.array(poses),
            points.world_m,
            points.observed_px,
            points.weights,
        )
        ratios: FloatArray = scores / np.maximum(points.weights.sum(axis=0), 1e-9)
        return ratios

    def _fit(self, points: PointObservations, mask: BoolArray, guess: FloatArray) -> FloatArray:
        k = np.flatnonzero(mask)
        # `optimize_pose` takes the disparity noise in pixels, but `score_poses` in units of
        # `noise_px`, so that disparities have less weight here. With 0.2 px here as well, results
        # are equal or worse (medians of 3 runs: start-people 0.0039 instead of 0.0035 m,
        # moving-door 0.0023 instead of 0.0022 m, three sets equal).
        return optimize_pose(
            self._stereo(),
            _GATES,
            points.world_m.take(k, 0),
            points.observed_px.take(k, 0),
            np.full(len(k), self.noise_px**-2),
            guess,
        ).T_camera_map

    def _stereo(self) -> StereoParams:
        pinhole = self._camera.gray_pinhole
        return StereoParams(
            pinhole.fx_px,
            pinhole.fy_px,
            pinhole.cx_px,
            pinhole.cy_px,
            self._camera.disparity_px_m,
            _DISPARITY_NOISE_PX / self.noise_px,
            0.0,
        )
