"""The pose of one image in which something may move that the filter did not detect.

The number of inliers does not reveal that the camera follows a moving object: near points dominate
the translation, and a wrong rotation compensates for the distant ones. Therefore well-observed
points, which several keyframes have seen, decide between pose hypotheses (decision 026). A region
of them that biases the pose of all others is left out (decision 036). The remaining matches refine
the pose as long as they do not contradict the well-observed points.
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

# The cost of a match is its squared error normalized by the measured noise, as
# `hoid_native.evaluate_matches` returns it.
_MEDIAN_COST = 2.366  # median of chi-square, three degrees of freedom: u, v and disparity
_MAX_COST = 9.832  # 5.991 + 3.841: 95 % quantiles for the pixel (two) and the disparity (one)
_CHI2_DISTINCT = 16.812  # 99 % quantile of chi-square, six degrees of freedom: a twist
_MIN_NOISE_SCALE = 0.01  # chosen: keeps the scale above zero where the matches are exact
_MIN_HALF = 10  # not tuned: matches that a hypothesis needs; three with depth determine a pose
# Not tuned: the pose without a region is computed only if leaving the region out decreases the
# cost, by a first-order estimate, by at least this share of the required decrease.
_MIN_FIRST_ORDER_GAIN = 0.4
# Chosen: a match counts as fitting another pose better if its cost, which is a squared error in
# units of the noise variance, is lower there by more than this.
_MIN_COST_DIFFERENCE = 1.0

# Chosen, not tuned: how far beyond the outermost matches a moving object may extend: 0.02 in
# x / z and y / z (10 px at a focal length of 520 px) and 5 % in depth.
_MARGIN = np.array([0.02, 0.02, 0.05])


class CompetingMotion(NamedTuple):
    """A second pose hypothesis that part of the matches fit better than the chosen pose.

    The usual cause is a large moving object in view.
    """

    twist: FloatArray  # (6,) left twist from the chosen pose to the other, rotation first [rad, m]
    # Share of the deciding matches that fit the chosen pose, and fit it better than the other one.
    chosen_ratio: float
    # Share of the deciding matches that fit the other pose, and fit it better than the chosen one.
    competing_ratio: float


class ViewRegion(NamedTuple):
    """A box in the coordinates x / z, y / z and log z of the camera frame, with z in m."""

    low: FloatArray  # (3,) lower bounds
    high: FloatArray  # (3,) upper bounds

    def contains(
        self, camera: StereoCamera, measured_px: Float32Array, depth_m: Float32Array
    ) -> BoolArray:
        """Return the (N,) mask of features in the region; without depth, by direction only."""
        u, v = measured_px[:, :2].T
        x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        location = np.stack([x, y, np.log(np.maximum(depth_m, MIN_DEPTH_M))])
        low, high = self.low - _MARGIN, self.high + _MARGIN
        is_inside = (low[:, None] <= location) & (location <= high[:, None])
        is_inside[2] |= depth_m <= 0
        return np.asarray(is_inside.all(0))


class BiasingObject(NamedTuple):
    """A moving object that would bias the pose if its matches were used."""

    region: ViewRegion  # the part of the view that the object covers
    # (N,) mask of the matches, in the whole image, that fit the biased pose better.
    prefers_its_motion: BoolArray


class Consensus(NamedTuple):
    """The pose of one image, and the moving objects that were noticed while estimating it."""

    estimate: PoseEstimate
    competing: CompetingMotion | None = None
    biasing: BiasingObject | None = None

    @property
    def covariance(self) -> FloatArray:
        """Return the (6, 6) covariance of the pose, camera frame, rotation first [rad^2, m^2].

        If there is a competing motion, this is the covariance of the mixture of both poses,
        weighted by their shares, about the chosen pose.
        """
        return covariance(self.estimate) + self.ambiguity

    @property
    def image_covariance(self) -> FloatArray:
        """Return the (6, 6) part of `covariance` whose errors differ from image to image."""
        return self.estimate.independent_share * covariance(self.estimate) + self.ambiguity

    @property
    def ambiguity(self) -> FloatArray:
        """Return the (6, 6) covariance that a competing motion adds to that of the pose."""
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
        """Return the (D,) mask of inliers, tested with the noise that all costs show."""
        return np.asarray(self.inliers & (self.cost <= CHI2_STEREO * _noise_scale(self.cost)))


class PoseConsensus:
    """Estimates the pose of one image from matches of which some may be on moving objects.

    `camera` has the noise that was measured in the images. A `prior` of the pose, such as that
    of a gyro, is used in the fit of each hypothesis.
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
        """Return the pose that the well-observed points support, starting from an initial one.

        If too few of the N matches are of well-observed points, all matches decide. If the
        consensus is switched off, the pose that fits all matches best is returned. For an initial
        pose (`is_initial`), which only guides the search for more matches, a small bias does no
        harm, and no biasing region is searched for.
        """
        fit_to_all = optimize_pose(self.camera, problem, T_camera_map, self.prior)
        if not self._config.enabled:
            return Consensus(fit_to_all)
        deciding = self._deciding_matches(problem, is_well_observed)
        fit = self._hypothesis(deciding, deciding, fit_to_all.T_camera_map)
        best, second = _best_two(fit, self._competing_hypotheses(deciding, fit))
        unbiased = None if is_initial else self._without_biasing_region(deciding, best)
        if unbiased is None:
            estimate = self._widened(problem, deciding, best, fit_to_all)
            return Consensus(estimate, _competing_motion(best, second))
        hypothesis, region = unbiased
        estimate = self._widened(problem, deciding, hypothesis, fit_to_all)
        biasing = BiasingObject(region, self._prefers(problem, best, estimate))
        return Consensus(estimate, _competing_motion(hypothesis, second or best), biasing)

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

    def _competing_hypotheses(self, deciding: PoseProblem, fit: _Hypothesis) -> list[_Hypothesis]:
        """Return the poses of the distant and of the near half of the deciding matches.

        A half that is consistent with `fit`, the pose of all deciding matches, is left out.
        """
        if len(deciding) < 2 * _MIN_HALF:
            return []
        depth_m = deciding.points_m @ fit.T_camera_map[2, :3]
        is_distant = depth_m >= median(depth_m)
        halves = (
            self._hypothesis_of_half(deciding, half, fit) for half in (is_distant, ~is_distant)
        )
        return [hypothesis for hypothesis in halves if hypothesis is not None]

    def _hypothesis_of_half(
        self, deciding: PoseProblem, half: BoolArray, fit: _Hypothesis
    ) -> _Hypothesis | None:
        """Return the pose of one half of the matches, refitted to all matches that support it.

        None is returned if `fit`, the pose of all D matches, is consistent with the half (D,).
        """
        matches_of_half = deciding.select(half)
        own = optimize_pose(self.camera, matches_of_half, fit.T_camera_map, self.prior)
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
        """Return the pose refitted without the most biasing region, and this region, if any.

        An object that moves slowly fits the pose of all matches nearly as well as the static
        scene, so that residuals do not show it. When its matches are left out, however, the pose
        of the other matches changes, and their cost falls by more than noise explains. In a blur,
        it falls whatever is left out; there, the other matches do not fit the new pose either.
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
        if median(found.cost[rest]) > _MEDIAN_COST:  # more than the measured noise explains
            return None
        return found._replace(inliers=found.inliers & rest), ViewRegion(worst.low, worst.high)

    def _widened(
        self,
        problem: PoseProblem,
        deciding: PoseProblem,
        hypothesis: _Hypothesis,
        fit_to_all: PoseEstimate,
    ) -> PoseEstimate:
        """Return the pose refitted to more matches if it is consistent with the hypothesis.

        First the pose of all matches is tried, then that of the matches that fit the hypothesis,
        which may increase the cost of its inliers by `max_cost_increase`.
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
        """Return whether an estimate fits a hypothesis's inliers as well as the hypothesis."""
        inliers = hypothesis.inliers
        cost = self._evaluate(deciding, estimate.T_camera_map).cost
        return self._is_consistent(cost[inliers], hypothesis.cost[inliers], tolerance)

    def _is_consistent(self, cost: FloatArray, least: FloatArray, tolerance: float) -> bool:
        """Return whether the costs (N,) of some matches are hardly higher than their minima.

        Their sum may be larger by the share `tolerance` and by `cost_margin`.
        """
        cost, least = _rescaled(cost, least)
        return bool(cost.sum() <= self._config.cost_margin + (1 + tolerance) * least.sum())

    def _prefers(
        self, problem: PoseProblem, other: _Hypothesis, estimate: PoseEstimate
    ) -> BoolArray:
        """Return the (N,) mask of matches that fit another hypothesis better than an estimate."""
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
    """Return the (N,) costs of two poses, normalized by the smaller noise and truncated."""
    scale = min(_noise_scale(cost), _noise_scale(other_cost))
    return np.minimum(cost / scale, _MAX_COST), np.minimum(other_cost / scale, _MAX_COST)


def _noise_scale(cost: FloatArray) -> float:
    """Return the noise variance that the median cost shows, as a share of the assumed variance.

    The noise in a new map is not measured yet. If it were assumed too large, a moving object would
    fit a pose halfway, and its few points would outweigh the many static ones.
    """
    typical = median(cost) if len(cost) else np.inf
    return min(max(typical / _MEDIAN_COST, _MIN_NOISE_SCALE), 1.0)


def _competing_motion(best: _Hypothesis, other: _Hypothesis | None) -> CompetingMotion | None:
    """Return the motion between two hypotheses; None if it is noise or has no supporters."""
    if other is None:
        return None
    twist = se3.log(other.T_camera_map @ se3.inverse(best.T_camera_map))
    is_better = best.cost <= other.cost
    shares = np.mean(best.inliers & is_better), np.mean(other.inliers & ~is_better)
    is_distinct = twist @ best.information @ twist > _CHI2_DISTINCT
    return CompetingMotion(twist, *map(float, shares)) if is_distinct and shares[1] > 0 else None
