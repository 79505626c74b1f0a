"""Parameters of which matches decide the pose of an image."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ConsensusConfig(Config):
    """Which matches decide the pose of an image.

    Costs are sums of squared errors in units of the measured noise.
    """

    enabled: bool = param(
        default=True,
        description='Lets what the map has established decide, so that nothing that moves '
        'captures the pose.',
    )
    min_observations: int = param(
        3, 'Number of keyframes that establish a point.', minimum=1, maximum=100
    )
    min_established: int = param(
        40, 'Number of matches of such points below which all decide.', minimum=4, maximum=1000
    )
    objection: float = param(
        0.15, 'Far or near points object to a pose that costs them more than their own by this '
        'share.', minimum=0.0, maximum=10.0,
    )  # fmt: skip
    tolerance: float = param(
        0.05, 'The pose of all matches is taken if it costs those that decide no more than this '
        'share above their own.', minimum=0.0, maximum=10.0,
    )  # fmt: skip
    margin: float = param(
        25.0, 'Cost that is never held against a pose, a number of squared noises.',
        minimum=0.0, maximum=1000.0,
    )  # fmt: skip
