"""Parameters of which matches decide the pose of an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

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
    leave_out_parts: bool = param(
        default=True,
        description='Leaves out the part of the map that drags the pose, so that what moves '
        'slowly does not take the camera along.',
    )

    # Keyframes that establish a point, and matches of such points below which all decide.
    min_observations: ClassVar[int] = 3
    min_established: ClassVar[int] = 40
    # Far or near points object to a pose that costs them more than their own by this share.
    objection: ClassVar[float] = 0.15
    # The rest of the map objects to a part of it that costs the rest more than this share.
    drag: ClassVar[float] = 0.025
    margin: ClassVar[float] = 25.0  # cost that is never held against a pose
