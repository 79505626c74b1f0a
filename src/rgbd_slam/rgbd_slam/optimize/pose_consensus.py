"""The pose of an image in which something may move that the filter has not detected.

The number of inliers does not reveal that the pose follows a moving object: near points dominate
the translation, and a wrong rotation compensates for the distant points. Therefore well-observed
points, which several keyframes have observed, decide between pose hypotheses (decision 026). An
image region whose points bias the pose is left out (decision 036). The other matches refine the
pose unless they contradict the well-observed points.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common import se3
from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import BoolArray, Float32Array, FloatArray
from hoid_native.results import MatchEvaluation
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.measured_noise import median
from rgbd_slam.optimize.pose_optimizer import (
    CHI2_STEREO,
    GATES,
    PoseEstimate,
    PosePrior,
    PoseProblem,
    covariance,
    optimize_pose,
)

# Costs of a match are squared errors normalized by the measured noise
# (`hoid_native.evaluate_matches`).
_MEDIAN_COST = 2.366  # median of chi-square with three degrees of freedom: u, v and disparity
# 5.991 + 3.841: 95 % quantiles of chi-square for the pixel (two) and the disparity (one).
_MAX_COST = 9.832
_CHI2_DISTINCT = 16.812  # 99 % quantile of chi-square with six degrees of freedom: a twist
_MIN_NOISE_SCALE = 0.01  # chosen: lower limit of the noise scale, for matches without errors
# Not tuned: least number of matches for a hypothesis; three with depth determine a pose.
_MIN_HALF = 10
# Not tuned: a region is tested by a new pose only if a first-order estimate of the decrease of the
# cost is at least this ratio of the required decrease.
_MIN_FIRST_ORDER_GAIN = 0.4
# Chosen: a match fits another pose better if its cost is lower there by more than this, in units
# of the noise variance.
_MIN_COST_DIFFERENCE = 1.0

# Chosen, not tuned: a moving object may extend beyond its outermost matches by 0.02 in x / z and y
# / z (10 px at a focal length of 520 px) and by 5 % in depth.
_MARGIN = np.array([0.02, 0.02, 0.05])


class CompetingMotion(NamedTuple):
    """A second pose hypothesis, which part of the matches fit better than the chosen pose.

    The usual cause is a large moving object in view.
    """

    # (6,) left twist from the chosen to the second pose, rotation first (rad, m).
    twist: FloatArray
    # Ratio of the deciding matches that fit the chosen pose, and fit it better than the second
    # one.
    chosen_ratio: float
    # Ratio of the deciding matches that fit the second pose, and fit it better than the chosen
    # one.
    competing_ratio: float


class ViewRegion(NamedTuple):
    """A box in the coordinates x / z, y / z and log z of the camera frame, with z in m."""

    low: FloatArray  # (3,) lower bounds
    high: FloatArray  # (3,) upper bounds

    def contains(
        self, camera: StereoCamera, measured_px: Float32Array, depth_m: Float32Array
    ) -> BoolArray:
        """Return the mask (N,) of features in the region; depth counts only where it is known."""
        u, v = measured_px[:, :2].T
        x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        location = np.stack([x, y, np.log(np.maximum(depth_m, MIN_DEPTH_M))])
        low, high = self.low - _MARGIN, self.high + _MARGIN
        is_inside = (low[:, None] <= location) & (location <= high[:, None])
        is_inside[2] |= depth_m <= 0
        return np.asarray(is_inside.all(0))


class BiasingObject(NamedTuple):
    """A moving object that would bias the pose if its matches were used."""

    region: ViewRegion  # the region of the view that the object covers
    # (N,) matches, anywhere in the image, that fit the biased pose better.
    prefers_its_motion: BoolArray


class Consensus(NamedTuple):
    """The pose of an image, and moving objects that were found while estimating it."""

    estimate: PoseEstimate
    competing: CompetingMotion | None = None
    biasing: BiasingObject | None = None
    # (6, 6) square of the left twist between the poses of the near and of the far half of the
    # matches, without what independent pixels explain; None: they have too few matches.
    disagreement: FloatArray | None = None

    @property
    def covariance(self) -> FloatArray:
        """Return the covariance (6, 6) of the pose (rad^2, m^2), camera frame, rotation first.

        With a competing motion, it is the covariance about the chosen pose of the mixture of both
        poses, weighted by their ratios.
        """
        return covariance(self.estimate) + self.ambiguity

    @property
    def image_covariance(self) -> FloatArray:
        """Return the part (6, 6) of `covariance` whose errors are independent between images."""
        return self.estimate.independent_share * covariance(self.estimate) + self.ambiguity

    @property
    def ambiguity(self) -> FloatArray:
        """Return the covariance (6, 6) that a competing motion adds to that of the pose."""
        if self.competing is None:
            return np.zeros((6, 6))
        twist, chosen, other = self.competing
        return np.asarray(other / (chosen + other) * np.outer(twist, twist))


class _Hypothesis(NamedTuple):
    """A candidate for the pose, and how well the D `_deciding_matches` fit it."""

    T_camera_map: FloatArray  # (4, 4)
    information: FloatArray  # (6, 6)
    cost: FloatArray  # (D,)
    inliers: BoolArray  # (D,)

    @property
    def supporters(self) -> BoolArray:
        """Return the mask (D,) of inliers that also fit at the noise estimated from all costs."""
        return np.asarray(self.inliers & (self.cost <= CHI2_STEREO * _noise_scale(self.cost)))


class PoseConsensus:
    """Estimates the pose of an image from matches some of which may be on moving objects.

    `camera` has the measured noise. A `prior` of the pose, such as one from a gyro, is used in the
    fit of each hypothesis.
    """

    def __init__(
        self, camera: StereoCamera, config: ConsensusConfig, prior: PosePrior | None = None
    ) -> None:
        self.camera = camera
        self._config = config
        self.prior = prior

    def solve(
        self,
        problem: PoseProblem,
        is_well_observed: BoolArray,
        T_camera_map: FloatArray,
        *,
        is_initial: bool = False,
    ) -> Consensus:
        """Return the pose that the well-observed points support, from an initial pose (4, 4).

        If too few of the N matches are of well-observed points, all matches decide. If the
        consensus is disabled, the pose that fits all matches best is returned. With `is_initial`,
        the result only guides the search for more matches: a small bias does no harm, so that no
        biasing region is searched for.
        """
        fit_to_all = optimize_pose(self.camera, problem, T_camera_map, self.prior)
        if not self._config.enabled:
            return Consensus(fit_to_all)
        deciding = self._deciding_matches(problem, is_well_observed)
        fit = self._hypothesis(deciding, deciding, fit_to_all.T_camera_map)
        halves = self._halves(deciding, fit)
        competing = (self._hypothesis_of_half(deciding, *half, fit) for half in halves)
        best, second = _best_two(fit, (other for other in competing if other is not None))
        poses = [own for _, own in halves]
        disagreement = None if is_initial or not poses else _disagreement(*poses)
        unbiased = None if is_initial else self._without_biasing_region(deciding, best)
        if unbiased is None:
            estimate = self._widened(problem, deciding, best, fit_to_all)
            return Consensus(estimate, _competing_motion(best, second), None, disagreement)
        hypothesis, region = unbiased
        estimate = self._widened(problem, deciding, hypothesis, fit_to_all)
        biasing = BiasingObject(region, self._prefers(problem, best, estimate))
        competing_motion = _competing_motion(hypothesis, second or best)
        return Consensus(estimate, competing_motion, biasing, disagreement)

    def _deciding_matches(self, problem: PoseProblem, is_well_observed: BoolArray) -> PoseProblem:
        if np.count_nonzero(is_well_observed) < self._config.min_well_observed:
            is_well_observed = np.ones(len(problem), np.bool_)
        return problem.select(is_well_observed)

    def _hypothesis(
        self, deciding: PoseProblem, fitted: PoseProblem, T_camera_map: FloatArray
    ) -> _Hypothesis:
        """Return the pose fitted to the matches `fitted`, evaluated on all deciding matches."""
        fit = optimize_pose(self.camera, fitted, T_camera_map, self.prior)
        cost, inliers = self._evaluate(deciding, fit.T_camera_map)
        return _Hypothesis(fit.T_camera_map, fit.information, cost, inliers)

    def _halves(
        self, deciding: PoseProblem, fit: _Hypothesis
    ) -> list[tuple[BoolArray, PoseEstimate]]:
        """Return the distant and the near half of the D matches, as masks, and their own poses."""
        if len(deciding) < 2 * _MIN_HALF:
            return []
        depth_m = deciding.points_m @ fit.T_camera_map[2, :3]
        is_distant = depth_m >= median(depth_m)
        return [
            (half, optimize_pose(self.camera, deciding.select(half), fit.T_camera_map, self.prior))
            for half in (is_distant, ~is_distant)
        ]

    def _hypothesis_of_half(
        self, deciding: PoseProblem, half: BoolArray, own: PoseEstimate, fit: _Hypothesis
    ) -> _Hypothesis | None:
        """Return the pose of a half (D,) of the matches, refitted to all matches that support it.

        `own` is the pose fitted to the half. None if the half is consistent with `fit`, the pose
        of all D matches.
        """
        matches_of_half = deciding.select(half)
        least = self._evaluate(matches_of_half, own.T_camera_map).cost
        if self._is_consistent(fit.cost[half], least, self._config.max_cost_increase):
            return None
        used = half.copy()
        used[half] = own.inliers
        found = self._hypothesis(deciding, deciding.select(used), own.T_camera_map)
        supporters = deciding.select(found.supporters)
        return self._hypothesis(deciding, supporters, found.T_camera_map)

    def _without_biasing_region(
        self, deciding: PoseProblem, biased: _Hypothesis
    ) -> tuple[_Hypothesis, ViewRegion] | None:
        """Return the pose refitted without the most biasing region, and this region, or None.

        A slowly moving object fits the pose of all matches nearly as well as the static scene, so
        that residuals do not reveal it. But if its matches are left out, the pose of the others
        changes, and their cost falls by more than noise explains. In blurred images the cost falls
        whatever is left out, but then the other matches do not fit the new pose either.
        """
        config = self._config
        if not config.leave_out_parts or len(deciding) < config.min_well_observed:
            return None
        worst = hoid_native.most_biasing_region(
            self.camera.lens,
            GATES,
            *deciding.arrays,
            biased.T_camera_map,
            _noise_scale(biased.cost),
        )
        rest = ~worst.mask
        cost, _ = _rescaled(biased.cost[rest], biased.cost[rest])
        required = config.cost_margin + config.min_cost_decrease * cost.sum()
        if worst.gain < _MIN_FIRST_ORDER_GAIN * required:
            return None
        found = self._hypothesis(deciding, deciding.select(rest), biased.T_camera_map)
        if self._is_consistent(biased.cost[rest], found.cost[rest], config.min_cost_decrease):
            return None
        # Larger errors than the measured noise explains.
        if median(found.cost[rest]) > _MEDIAN_COST:
            return None
        return found._replace(inliers=found.inliers & rest), ViewRegion(worst.low, worst.high)

    def _widened(
        self,
        problem: PoseProblem,
        deciding: PoseProblem,
        hypothesis: _Hypothesis,
        fit_to_all: PoseEstimate,
    ) -> PoseEstimate:
        """Return the pose refitted to more matches if that is consistent with the hypothesis.

        First the pose of all matches is tried, then that of all matches which fit the hypothesis;
        the latter may increase the cost of its inliers by `max_cost_increase`.
        """
        if self._supports(deciding, hypothesis, fit_to_all, 0.0):
            return fit_to_all
        evaluated = self._evaluate(problem, hypothesis.T_camera_map)
        limit = CHI2_STEREO * _noise_scale(hypothesis.cost)
        fitting = problem.select(evaluated.inliers & (evaluated.cost <= limit))
        refit = optimize_pose(self.camera, fitting, hypothesis.T_camera_map, self.prior)
        is_kept = self._supports(deciding, hypothesis, refit, self._config.max_cost_increase)
        kept = refit if is_kept else hypothesis
        return PoseEstimate(
            kept.T_camera_map,
            self._evaluate(problem, kept.T_camera_map).inliers,
            kept.information,
            fit_to_all.independent_share,
        )

    def _supports(
        self,
        deciding: PoseProblem,
        hypothesis: _Hypothesis,
        estimate: PoseEstimate,
        tolerance: float,
    ) -> bool:
        """Return whether the hypothesis's inliers fit an estimate as well as the hypothesis."""
        inliers = hypothesis.inliers
        cost = self._evaluate(deciding, estimate.T_camera_map).cost
        return self._is_consistent(cost[inliers], hypothesis.cost[inliers], tolerance)

    def _is_consistent(self, cost: FloatArray, least: FloatArray, tolerance: float) -> bool:
        """Return whether costs (N,) of matches are hardly higher than their least costs (N,).

        The sum may be higher by the ratio `tolerance` plus `cost_margin`.
        """
        cost, least = _rescaled(cost, least)
        return bool(cost.sum() <= self._config.cost_margin + (1 + tolerance) * least.sum())

    def _prefers(
        self, problem: PoseProblem, other: _Hypothesis, estimate: PoseEstimate
    ) -> BoolArray:
        """Return the mask (N,) of matches that fit another hypothesis better than an estimate."""
        other_cost, cost = _rescaled(
            self._evaluate(problem, other.T_camera_map).cost,
            self._evaluate(problem, estimate.T_camera_map).cost,
        )
        return np.asarray(cost > other_cost + _MIN_COST_DIFFERENCE)

    def _evaluate(self, problem: PoseProblem, T_camera_map: FloatArray) -> MatchEvaluation:
        return hoid_native.evaluate_matches(self.camera.lens, GATES, *problem.arrays, T_camera_map)


def _best_two(
    fit: _Hypothesis, competing: Iterable[_Hypothesis]
) -> tuple[_Hypothesis, _Hypothesis | None]:
    """Return the hypotheses with the lowest and the second lowest cost; the second may be None."""
    best, second = fit, None
    for hypothesis in competing:
        is_best = _is_better(hypothesis, best)
        best, other = (hypothesis, best) if is_best else (best, hypothesis)
        if second is None or _is_better(other, second):
            second = other
    return best, second


def _is_better(one: _Hypothesis, other: _Hypothesis) -> bool:
    cost, other_cost = _rescaled(one.cost, other.cost)
    return bool(cost.sum() < other_cost.sum())


def _rescaled(cost: FloatArray, other_cost: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the costs (N,) of two poses, normalized by the smaller noise and truncated."""
    scale = min(_noise_scale(cost), _noise_scale(other_cost))
    return np.minimum(cost / scale, _MAX_COST), np.minimum(other_cost / scale, _MAX_COST)


def _noise_scale(cost: FloatArray) -> float:
    """Return the noise variance, from the median cost, as a ratio to the assumed variance.

    In a new map, the noise is not measured yet. If the assumed one were too large, a moving object
    would half fit a pose, and its few points would outweigh the many static ones.
    """
    typical = median(cost) if len(cost) else np.inf
    return min(max(typical / _MEDIAN_COST, _MIN_NOISE_SCALE), 1.0)


def _competing_motion(best: _Hypothesis, other: _Hypothesis | None) -> CompetingMotion | None:
    """Return the motion between two hypotheses; None if it is only noise or has no support."""
    if other is None:
        return None
    twist = se3.log(other.T_camera_map @ se3.inverse(best.T_camera_map))
    is_better = best.cost <= other.cost
    shares = np.mean(best.inliers & is_better), np.mean(other.inliers & ~is_better)
    is_distinct = twist @ best.information @ twist > _CHI2_DISTINCT
    return CompetingMotion(twist, *map(float, shares)) if is_distinct and shares[1] > 0 else None


def _disagreement(one: PoseEstimate, other: PoseEstimate) -> FloatArray:
    """Return the (6, 6) square of the twist between two poses, less their independent noise."""
    twist = se3.log(other.T_camera_map @ se3.inverse(one.T_camera_map))
    noise = sum(half.independent_share * covariance(half) for half in (one, other))
    return np.asarray(np.outer(twist, twist) - noise)
