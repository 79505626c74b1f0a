"""Parameters of the consensus, which decides which matches determine the pose of an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ConsensusConfig(Config):
    """Pose estimation by consensus: matches of well-observed map points decide (decision 026).

    A map point is well observed if at least `min_observations` keyframes observe it. Matches of
    such points decide between pose hypotheses; if there are fewer than `min_well_observed`, all
    matches decide. The other matches refine the pose unless they contradict those of well-observed
    points. The cost of a pose is the sum of the squared residuals of its matches, each divided by
    its measured variance.
    """

    enabled: bool = param(
        default=True,  # ablation: slow-6 by `motion` 0.112 m without it, 0.003 m with it
        description='Whether to estimate the pose of an image from the map points that several '
        'keyframes have observed, so that the camera is not tracked relative to a moving object.',
    )
    # Whether matches are left out that lie in an image region which biases the pose, so that a
    # slowly moving object does not distort it (decision 036: error on slow-6 by `motion` 0.010 m
    # without it, 0.004 m with it).
    leave_out_parts: bool = param(default=True, internal=True)

    # A point is well observed if at least this number of keyframes have observed it. Decision 026:
    # with fewer, the error on fr1_xyz_people is 0.013 m instead of 0.009 m.
    min_observations: ClassVar[int] = 3
    # With fewer matches of well-observed points, all matches count alike. Not tuned.
    min_well_observed: ClassVar[int] = 40
    # A pose is rejected if, for the far or the near half of the well-observed points, its cost is
    # higher by more than this ratio than the cost of the pose that fits this half (decision 026).
    # Not tuned.
    max_cost_increase: ClassVar[float] = 0.15
    # A region biases the pose if the cost of all other points falls by at least this ratio when
    # the pose is estimated without the region (decision 036). With 1 % and 5 %, the error on
    # the synthetic sequence slow-6 is larger.
    min_cost_decrease: ClassVar[float] = 0.025
    # Constant that the difference of two costs must exceed in addition to `max_cost_increase` or
    # `min_cost_decrease`. Not tuned. On fr1_xyz, where nothing moves, leaving a region out changes
    # the cost by at most 52 (decision 036).
    cost_margin: ClassVar[float] = 25.0
