"""The pose of one image in which something may move that the filter did not detect.

The number of inliers does not reveal that the camera follows a moving object: near points dominate
the translation, a wrong rotation compensates for the distant ones, and every keyframe creates new
points on the moving object. Therefore well-observed points, which several keyframes have seen,
decide between pose hypotheses (decision 026). A region of them that biases the pose of all others
is left out (decision 036). The remaining matches refine the pose as long as they do not contradict
the well-observed points.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray
from hoid_native.results import MatchEvaluation
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.pose_optimizer import (
    CHI2_STEREO,
    GATES,
    PoseEstimate,
    PoseProblem,
    covariance,
    optimize_pose,
)
from rgbd_slam.optimize.view_region import ViewRegion

# The cost of a match is its squared error normalized by the measured noise, as
# `hoid_native.evaluate_matches` returns it.
_MEDIAN_COST = 2.366  # median of chi-square, three degrees of freedom: u, v and disparity
_MAX_COST = 9.832  # 5.991 + 3.841: 95 % quantiles for the pixel (two) and the disparity (one)
_CHI2_DISTINCT = 16.812  # 99 % quantile of chi-square, six degrees of freedom: a twist
_MIN_NOISE_SCALE = 0.01  # chosen: keeps the scale above zero where the matches are exact
_MIN_HALF = 10  # not tuned: matches that a hypothesis needs; two with depth determine a pose
# Not tuned: passes in which a hypothesis collects the matches that fit it; the first one fits the
# inliers of its half.
_NUM_PASSES = 2
# Not tuned: the first-order gain of leaving a region out, as a share of the required one, from
# which the pose without it is computed.
_MIN_FIRST_ORDER_GAIN = 0.4
_MIN_COST_DIFFERENCE = 1.0  # chosen: a match prefers a motion if it costs it one variance less


class CompetingMotion(NamedTuple):
    """A second motion that explains part of the image better than the chosen pose does."""

    twist: FloatArray  # (6,) left twist from the chosen pose to the other, rotation first [rad, m]
    chosen_share: (
        float  # share of the deciding matches that fit the chosen pose, and fit it better
    )
    competing_share: float  # and share of those that fit the competing pose better


class BiasingObject(NamedTuple):
    """A moving object that would bias the pose."""

    region: ViewRegion
    prefers_its_motion: BoolArray  # (N,) matches, anywhere, that fit the biased pose better


class Consensus(NamedTuple):
    """The pose of an image, a competing motion and an object that would bias it, if any."""

    estimate: PoseEstimate
    competing: CompetingMotion | None = None
    biasing: BiasingObject | None = None

    @property
    def covariance(self) -> FloatArray:
        """Return the (6, 6) covariance in the camera frame, rotation first [rad^2, m^2].

        With a competing motion, it is the covariance of the mixture of both poses, weighted by
        their shares, about the chosen one.
        """
        return covariance(self.estimate) + self.ambiguity

    @property
    def image_covariance(self) -> FloatArray:
        """Return the (6, 6) part of the covariance that successive images do not share."""
        return self.estimate.independent_share * covariance(self.estimate) + self.ambiguity

    @property
    def ambiguity(self) -> FloatArray:
        """Return the (6, 6) covariance due to the competing motion; 0 without one."""
        if self.competing is None:
            return np.zeros((6, 6))
        twist, chosen, other = self.competing
        return np.asarray(other / (chosen + other) * np.outer(twist, twist))


class _Hypothesis(NamedTuple):
    """A pose and how well the deciding matches fit it."""

    T_camera_map: FloatArray  # (4, 4)
    information: FloatArray  # (6, 6)
    cost: FloatArray  # (D,)
    inliers: BoolArray  # (D,)

    @property
    def supporters(self) -> BoolArray:
        """Return the (D,) mask of inliers at the noise that the hypothesis itself shows."""
        return np.asarray(self.inliers & (self.cost <= CHI2_STEREO * _noise_scale(self.cost)))


class PoseConsensus:
    """Estimates the pose of one image from matches of which some may be on moving objects.

    Args:
        camera: The camera with its measured noise.
        config: Parameters.
    """

    def __init__(self, camera: StereoCamera, config: ConsensusConfig) -> None:
        self._camera = camera
        self._config = config

    def solve(
        self,
        problem: PoseProblem,
        is_well_observed: BoolArray,
        T_camera_map: FloatArray,
        *,
        is_initial: bool = False,
    ) -> Consensus:
        """Return the pose that the well-observed points support, starting from an initial one.

        Args:
            problem: N matches.
            is_well_observed: (N,) mask of the matches whose points several keyframes have seen.
            T_camera_map: (4, 4) initial pose.
            is_initial: True for a pose that only guides the search for more matches: a small bias
                does no harm there, and no biasing region is searched.
        """
        fit_to_all = optimize_pose(self._camera, problem, T_camera_map)
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
        """Return the matches of well-observed points, or all if there are few, as in a new map."""
        if np.count_nonzero(is_well_observed) < self._config.min_well_observed:
            is_well_observed = np.ones(len(problem), np.bool_)
        return problem.select(is_well_observed)

    def _hypothesis(
        self, deciding: PoseProblem, fitted: PoseProblem, T_camera_map: FloatArray
    ) -> _Hypothesis:
        """Return the pose fitted to some matches, evaluated on all deciding ones."""
        fit = optimize_pose(self._camera, fitted, T_camera_map)
        cost, inliers = self._evaluate(deciding, fit.T_camera_map)
        return _Hypothesis(fit.T_camera_map, fit.information, cost, inliers)

    def _competing_hypotheses(self, deciding: PoseProblem, fit: _Hypothesis) -> list[_Hypothesis]:
        """Return the poses of the distant and the near half of the matches, if they contradict."""
        if len(deciding) < 2 * _MIN_HALF:
            return []
        depth_m = deciding.points_m @ fit.T_camera_map[2, :3]
        is_distant = depth_m >= np.median(depth_m)
        halves = (
            self._hypothesis_of_half(deciding, half, fit) for half in (is_distant, ~is_distant)
        )
        return [hypothesis for hypothesis in halves if hypothesis is not None]

    def _hypothesis_of_half(
        self, deciding: PoseProblem, half: BoolArray, fit: _Hypothesis
    ) -> _Hypothesis | None:
        """Return the pose of one half and all that fit it; None if `fit` agrees with the half."""
        matches_of_half = deciding.select(half)
        own = optimize_pose(self._camera, matches_of_half, fit.T_camera_map)
        least = self._evaluate(matches_of_half, own.T_camera_map).cost
        if self._is_consistent(fit.cost[half], least, self._config.max_cost_increase):
            return None
        used = half.copy()
        used[half] = own.inliers
        found = self._hypothesis(deciding, deciding.select(used), own.T_camera_map)
        for _ in range(_NUM_PASSES - 1):
            supporters = deciding.select(found.supporters)
            found = self._hypothesis(deciding, supporters, found.T_camera_map)
        return found

    def _without_biasing_region(
        self, deciding: PoseProblem, biased: _Hypothesis
    ) -> tuple[_Hypothesis, ViewRegion] | None:
        """Return the pose without the region that biases it most, and the region, if there is one.

        An object that moves slowly fits the pose of all matches nearly as well as the static
        scene, so that residuals do not show it. Without its equations, however, the pose of the
        rest moves, and the cost of the rest falls by more than noise explains.
        """
        config = self._config
        if not config.leave_out_parts or len(deciding) < config.min_well_observed:
            return None
        worst = hoid_native.most_biasing_region(
            self._camera.lens,
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
        return found._replace(inliers=found.inliers & rest), ViewRegion(worst.low, worst.high)

    def _widened(
        self,
        problem: PoseProblem,
        deciding: PoseProblem,
        hypothesis: _Hypothesis,
        fit_to_all: PoseEstimate,
    ) -> PoseEstimate:
        """Return the pose refitted to more matches if it is consistent with the hypothesis.

        The pose of all matches is kept if it costs the inliers of the hypothesis no more; else the
        pose is refitted to all matches that fit the hypothesis, and kept within a tolerance; else
        the hypothesis is returned.
        """
        if self._supports(deciding, hypothesis, fit_to_all, 0.0):
            return fit_to_all
        evaluated = self._evaluate(problem, hypothesis.T_camera_map)
        limit = CHI2_STEREO * _noise_scale(hypothesis.cost)
        fitting = problem.select(evaluated.inliers & (evaluated.cost <= limit))
        refit = optimize_pose(self._camera, fitting, hypothesis.T_camera_map)
        is_kept = self._supports(deciding, hypothesis, refit, self._config.max_cost_increase)
        T_camera_map, information = refit[::2] if is_kept else hypothesis[:2]
        inliers = self._evaluate(problem, T_camera_map).inliers
        return PoseEstimate(T_camera_map, inliers, information, fit_to_all.independent_share)

    def _supports(
        self,
        deciding: PoseProblem,
        hypothesis: _Hypothesis,
        estimate: PoseEstimate,
        tolerance: float,
    ) -> bool:
        """Return whether an estimate fits the inliers of a hypothesis nearly as well."""
        inliers = hypothesis.inliers
        cost = self._evaluate(deciding, estimate.T_camera_map).cost
        return self._is_consistent(cost[inliers], hypothesis.cost[inliers], tolerance)

    def _is_consistent(self, cost: FloatArray, least: FloatArray, tolerance: float) -> bool:
        """Return whether the total cost exceeds the least one by no more than a share of it."""
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
        return hoid_native.evaluate_matches(
            self._camera.lens, GATES, *problem.arrays, T_camera_map
        )


def _best_two(
    fit: _Hypothesis, competing: Iterable[_Hypothesis]
) -> tuple[_Hypothesis, _Hypothesis | None]:
    """Return the hypothesis with the least cost, and the one with the second least."""
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
    """Return the costs of two poses, truncated, at the noise that the better one shows."""
    scale = min(_noise_scale(cost), _noise_scale(other_cost))
    return np.minimum(cost / scale, _MAX_COST), np.minimum(other_cost / scale, _MAX_COST)


def _noise_scale(cost: FloatArray) -> float:
    """Return the noise variance that the median cost shows, relative to the assumed; at most 1.

    The noise in a new map is not measured yet. If it were assumed too large, a moving object would
    fit a pose halfway, and its few points would outweigh the many static ones.
    """
    median = float(np.median(cost)) if len(cost) else np.inf
    return min(max(median / _MEDIAN_COST, _MIN_NOISE_SCALE), 1.0)


def _competing_motion(best: _Hypothesis, other: _Hypothesis | None) -> CompetingMotion | None:
    """Return the motion between two hypotheses if it exceeds the noise and has supporters."""
    if other is None:
        return None
    twist = se3.log(other.T_camera_map @ se3.inverse(best.T_camera_map))
    is_better = best.cost <= other.cost
    shares = np.mean(best.inliers & is_better), np.mean(other.inliers & ~is_better)
    is_distinct = twist @ best.information @ twist > _CHI2_DISTINCT
    return CompetingMotion(twist, *map(float, shares)) if is_distinct and shares[1] > 0 else None
