"""The pose of an image in which something may move undetected: hypotheses, and who decides.

Counting inliers cannot tell that a tracker follows what moves: near points dominate translation,
far ones give way by a turn, and each keyframe makes new points on what moves. Here the points that
several keyframes have seen decide, by their truncated cost at the measured noise (MSAC, Torr and
Zisserman, CVIU 2000): between the pose that fits them all, and those that suit their far or their
near half where that objects. A part of them that drags the pose of the rest is left out. All that
is matched has its say where these have no objection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray
from hoid_native.results import MatchEvaluation
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.moving_part import Region
from rgbd_slam.optimize.pose_optimizer import (
    CHI2_STEREO,
    GATES,
    PoseEstimate,
    PoseProblem,
    covariance,
    optimize_pose,
)

_MEDIAN_COST = 2.366  # of three degrees of freedom, at the true noise
_MAX_COST = 9.832  # pixel and disparity at their gates
_MIN_SCALE = 0.01
_MIN_HALF = 10  # matches that make a hypothesis
_CHI2_APART = 16.812  # 99 % of six degrees of freedom
_LIKELY = 0.4  # of the limit, to first order: a part that may drag the pose
_PREFERRED = 1.0  # less cost by which a match prefers a motion
_ROUNDS = 2  # in which a hypothesis gathers what fits it


class Rival(NamedTuple):
    """Another motion that explains the image: part of the map objects to the pose, or would."""

    twist: FloatArray  # (6,) from the pose to the rival's, left, rotation first [rad, m]
    chosen_share: float  # of the deciding matches, those that fit the pose, and fit it better
    rival_share: float  # and those that fit the rival better


class Dragging(NamedTuple):
    """What moves by itself and would drag the pose along."""

    region: Region
    moves: BoolArray  # (N,) matches that fit its motion better, wherever they are


class Consensus(NamedTuple):
    """A pose, and whether another one suits part of the map better."""

    estimate: PoseEstimate
    rival: Rival | None = None
    dragging: Dragging | None = None

    @property
    def covariance(self) -> FloatArray:
        """Return (6, 6) of a small motion in the camera's own frame, rotation first [rad^2, m^2].

        With a rival it is that of both poses, weighted by who follows them, around the chosen one.
        """
        return covariance(self.estimate) + self.ambiguity

    @property
    def image_covariance(self) -> FloatArray:
        """Return (6, 6) of what the image errs by alone, as in the motion between two in a row."""
        return self.estimate.own_share * covariance(self.estimate) + self.ambiguity

    @property
    def ambiguity(self) -> FloatArray:
        """Return (6, 6) of that between the two poses; 0 without a rival."""
        if self.rival is None:
            return np.zeros((6, 6))
        twist, chosen, other = self.rival
        return np.asarray(other / (chosen + other) * np.outer(twist, twist))


class _Hypothesis(NamedTuple):
    """A pose, and what the core says of it."""

    T_camera_map: FloatArray  # (4, 4)
    information: FloatArray  # (6, 6)
    cost: FloatArray  # (C,)
    inliers: BoolArray  # (C,)

    @property
    def fitting(self) -> BoolArray:
        """Return (C,) which inliers fit as well as the noise that the pose shows lets expect."""
        return np.asarray(self.inliers & (self.cost <= CHI2_STEREO * _noise_scale(self.cost)))


class PoseConsensus:
    """Solves for the pose of one image.

    Args:
        camera: With the noise measured so far.
        config: Parameters.
    """

    def __init__(self, camera: StereoCamera, config: ConsensusConfig) -> None:
        self._camera = camera
        self._config = config

    def solve(
        self,
        problem: PoseProblem,
        is_established: BoolArray,
        T_camera_map: FloatArray,
        *,
        is_first: bool = False,
    ) -> Consensus:
        """Return the pose that explains the matches best, from an initial one.

        Args:
            problem: N matches.
            is_established: (N,) mask of those whose points several keyframes have seen. Where they
                are few, as in a new map, all matches decide.
            T_camera_map: (4, 4) about where the camera is.
            is_first: Whether more is matched by what this gives: parts may drag it a little.
        """
        usual = optimize_pose(self._camera, problem, T_camera_map)
        if not self._config.enabled:
            return Consensus(usual)
        is_core = is_established
        if np.count_nonzero(is_established) < self._config.min_well_observed:
            is_core = np.ones(len(problem), np.bool_)
        core = problem.select(is_core)
        best = self._hypothesis(core, core, usual.T_camera_map)
        rival = None
        for other in self._objections(core, best):
            if _is_better(other, best):
                best, other = other, best  # noqa: PLW2901
            if rival is None or _is_better(other, rival):
                rival = other
        freed = None if is_first else self._freed(core, best)
        if freed is None:
            estimate = self._widened(problem, is_core, best, usual)
            return Consensus(estimate, _compared(best, rival))
        rest, region = freed
        estimate = self._widened(problem, is_core, rest, usual)
        dragged, cost = _rescaled(
            self._judge(problem, best.T_camera_map)[0],
            self._judge(problem, estimate.T_camera_map)[0],
        )
        dragging = Dragging(region, cost > dragged + _PREFERRED)
        return Consensus(estimate, _compared(rest, best if rival is None else rival), dragging)

    def _hypothesis(
        self, core: PoseProblem, fitted: PoseProblem, T_camera_map: FloatArray
    ) -> _Hypothesis:
        """Return the pose that fits some of the core."""
        fit = optimize_pose(self._camera, fitted, T_camera_map)
        cost, inliers = self._judge(core, fit.T_camera_map)
        return _Hypothesis(fit.T_camera_map, fit.information, cost, inliers)

    def _objections(self, core: PoseProblem, best: _Hypothesis) -> list[_Hypothesis]:
        """Return what the far and the near half of the core would have in place of a pose."""
        if len(core) < 2 * _MIN_HALF:
            return []
        depth_m = core.points_m @ best.T_camera_map[2, :3]
        is_far = depth_m >= np.median(depth_m)
        found = (self._objection(core, half, best) for half in (is_far, ~is_far))
        return [hypothesis for hypothesis in found if hypothesis is not None]

    def _objection(
        self, core: PoseProblem, half: BoolArray, best: _Hypothesis
    ) -> _Hypothesis | None:
        """Return the pose that one half suits much better, with what else of the core fits it."""
        on_half = core.select(half)
        fit = optimize_pose(self._camera, on_half, best.T_camera_map)
        least = self._judge(on_half, fit.T_camera_map)[0]
        if self._agree(best.cost[half], least, self._config.max_cost_increase):
            return None
        used = half.copy()
        used[half] = fit.inliers
        found = self._hypothesis(core, core.select(used), fit.T_camera_map)
        for _ in range(_ROUNDS - 1):
            found = self._hypothesis(core, core.select(found.fitting), found.T_camera_map)
        return found

    def _freed(self, core: PoseProblem, dragged: _Hypothesis) -> tuple[_Hypothesis, Region] | None:
        """Return the pose of the core without a part that drags it, and where that is."""
        config = self._config
        if not config.leave_out_parts or len(core) < config.min_well_observed:
            return None
        part = hoid_native.most_biasing_region(
            self._camera.lens,
            GATES,
            *core.arrays,
            dragged.T_camera_map,
            _noise_scale(dragged.cost),
        )
        rest = ~part.mask
        cost, _ = _rescaled(dragged.cost[rest], dragged.cost[rest])
        if part.gain < _LIKELY * (config.cost_margin + config.min_cost_decrease * cost.sum()):
            return None
        found = self._hypothesis(core, core.select(rest), dragged.T_camera_map)
        if self._agree(dragged.cost[rest], found.cost[rest], config.min_cost_decrease):
            return None
        return found._replace(inliers=found.inliers & rest), Region(part.low, part.high)

    def _widened(
        self, problem: PoseProblem, is_core: BoolArray, best: _Hypothesis, usual: PoseEstimate
    ) -> PoseEstimate:
        """Return the pose of all matches, or of those that fit, if the core can live with it."""
        if self._suits(problem, is_core, best, usual, 0.0):
            return usual
        judged = self._judge(problem, best.T_camera_map)
        fits = judged.inliers & (judged.cost <= CHI2_STEREO * _noise_scale(best.cost))
        wider = optimize_pose(self._camera, problem.select(fits), best.T_camera_map)
        is_wider = self._suits(problem, is_core, best, wider, self._config.max_cost_increase)
        T, information = wider[::2] if is_wider else best[:2]
        inliers = self._judge(problem, T)[1]
        return PoseEstimate(T, inliers, information, usual.own_share)

    def _suits(
        self,
        problem: PoseProblem,
        is_core: BoolArray,
        best: _Hypothesis,
        estimate: PoseEstimate,
        tolerance: float,
    ) -> bool:
        """Return whether what decided on a pose agrees with another one."""
        decided = best.inliers
        cost = self._judge(problem.select(is_core), estimate.T_camera_map)[0]
        return self._agree(cost[decided], best.cost[decided], tolerance)

    def _agree(self, cost: FloatArray, least: FloatArray, tolerance: float) -> bool:
        cost, least = _rescaled(cost, least)
        return bool(cost.sum() <= self._config.cost_margin + (1 + tolerance) * least.sum())

    def _judge(self, problem: PoseProblem, T_camera_map: FloatArray) -> MatchEvaluation:
        return hoid_native.evaluate_matches(
            self._camera.lens, GATES, *problem.arrays, T_camera_map
        )


def _is_better(one: _Hypothesis, other: _Hypothesis) -> bool:
    cost, other_cost = _rescaled(one.cost, other.cost)
    return bool(cost.sum() < other_cost.sum())


def _rescaled(cost: FloatArray, other_cost: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two poses' costs at the noise that the better one shows."""
    scale = min(_noise_scale(cost), _noise_scale(other_cost))
    return np.minimum(cost / scale, _MAX_COST), np.minimum(other_cost / scale, _MAX_COST)


def _noise_scale(cost: FloatArray) -> float:
    """Return the noise that the median of costs shows, in units of that assumed, at most 1.

    A new map's noise is not measured yet. At one assumed too large what moves would fit a pose
    halfway, and few that do count more than many that rest.
    """
    middle = float(np.median(cost)) if len(cost) else np.inf
    return min(max(middle / _MEDIAN_COST, _MIN_SCALE), 1.0)


def _compared(best: _Hypothesis, other: _Hypothesis | None) -> Rival | None:
    """Return a rival that some follow, and further off than noise as configured explains."""
    if other is None:
        return None
    twist = se3.log(other.T_camera_map @ se3.inverse(best.T_camera_map))
    is_better = best.cost <= other.cost
    shares = np.mean(best.inliers & is_better), np.mean(other.inliers & ~is_better)
    is_apart = twist @ best.information @ twist > _CHI2_APART
    return Rival(twist, *map(float, shares)) if is_apart and shares[1] > 0 else None
