"""Parameters of the consensus: which matches determine the pose of an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ConsensusConfig(Config):
    """Estimation of an image's pose, in which well-observed map points decide (decision 026).

    A map point is well observed if at least `min_observations` keyframes observe it. The matches
    of well-observed points decide between pose hypotheses; if there are fewer than
    `min_well_observed` such matches, all decide. The other matches refine the pose, as long as
    they do not contradict the matches of well-observed points. The cost of a pose is the sum of
    the squared residuals of its matches, each divided by its measured variance.
    """

    enabled: bool = param(
        default=True,  # ablation: slow-6 by `motion` 0.112 m without it, 0.003 m with it
        description='Whether to estimate the pose of an image from the map points that several '
        'keyframes have observed, so that the camera is not tracked relative to a moving object.',
    )
    # Whether to leave out the matches in a region of the image that biases the pose, so that a
    # slowly moving object does not distort it (decision 036: slow-6 by `motion` 0.010 m without
    # it, 0.004 m with it).
    leave_out_parts: bool = param(default=True, internal=True)

    # Smallest number of keyframes that must have observed a point for it to count as well
    # observed. Decision 026: with fewer, the error on fr1_xyz_people is 0.013 m instead of 0.009
    # m.
    min_observations: ClassVar[int] = 3
    # Not tuned; below this number of matches of well-observed points, all matches count alike.
    min_well_observed: ClassVar[int] = 40
    # Decision 026. A pose is rejected if the far or the near half of the well-observed points has
    # a cost that is higher by this share than with the pose that fits this half. Not tuned.
    max_cost_increase: ClassVar[float] = 0.15
    # Decision 036: a region biases the pose if the cost of the other points falls by this share
    # when the pose is estimated without it. With 1 % and 5 %, the error on `slow-6` is larger.
    min_cost_decrease: ClassVar[float] = 0.025
    # Not tuned: a constant that the difference of two costs must exceed in addition to
    # `max_cost_increase` or `min_cost_decrease`. On fr1_xyz, where nothing moves, leaving a region
    # out changes the cost by at most 52 (decision 036).
    cost_margin: ClassVar[float] = 25.0
