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
        True, 'What the map has established decides, so that nothing that moves captures the pose'
    )
    min_observations: int = param(3, 'Keyframes that establish a point', minimum=1, maximum=100)
    min_established: int = param(
        40, 'With fewer matches of such points all decide', minimum=4, maximum=1000
    )
    objection: float = param(
        0.15, 'Far or near points object to a pose that costs them so much more than their own',
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    tolerance: float = param(
        0.05, 'The pose of all matches is taken if it costs those that decide no more than this',
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    margin: float = param(
        25.0, 'Costs that are never held against a pose', minimum=0.0, maximum=1000.0
    )
