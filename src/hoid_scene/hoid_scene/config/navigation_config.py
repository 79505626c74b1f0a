"""Parameters of the masks for Nav2's costmap filters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param


@dataclass(frozen=True)
class NavigationConfig(Config):
    """Parameters of the two masks for Nav2's costmap filters.

    The keep-out mask covers handled objects and the predicted paths of walking people. People who
    stand have no keep-out area. The speed mask slows the robot down where people often walk.
    """

    enabled: bool = param(
        default=False,
        description='Whether to publish masks for the costmap filters of Nav2: keep_out_mask and '
        'speed_mask. It needs objects.enabled and frames.base of rgbd_slam.',
        expert=True,
    )
    horizon_s: float = param(
        2.0,  # chosen: a person at 1.2 m/s walks 2.4 m, which is half a room
        'Time for which the keep-out area follows a walking person into the future (s). Raise it '
        'for a slow robot; a robot that passes behind people needs less.',
        limits=(0.0, 10.0),
        expert=True,
    )
    margin_m: float = param(
        0.4,  # chosen: the personal space of Hall's proxemics starts at 0.45 m
        'Distance that is kept from the places where a walking person will be, and from the edge '
        'of a handled object (m). The inflation layer of Nav2 adds the radius of the robot.',
        limits=(0.0, 2.0),
        expert=True,
    )
    footprint_radius_m: float = param(
        0.4,  # chosen: the radius of an indoor robot
        'Radius around the base of the robot in which there is no keep-out area (m): that of the '
        'footprint, or more.',
        limits=(0.0, 5.0),
        expert=True,
    )
    classes: tuple[str, ...] = param(
        (),
        'Classes of handled objects around which there is a keep-out area; empty: all.',
        expert=True,
    )
    busy_speed_percent: float = param(
        50.0,  # chosen: at least halves a robot's stopping distance
        'Speed limit where people have crossed a cell of speed_mask five times, relative to the '
        'largest speed of the robot (%); after fewer crossings, the reduction is proportionally '
        'less.',
        limits=(1.0, 100.0),
        expert=True,
    )
    # Number of people who crossed a cell from which on the speed is reduced fully there. Chosen
    # for a family in one session.
    busy_crossings: ClassVar[int] = 5
    # Speed (m/s) below which people count as standing. Chosen: above the tracker's noise.
    walking_mps: ClassVar[float] = 0.25
    speed_cell_m: ClassVar[float] = 0.25  # chosen: half the width of a person
    period_s: ClassVar[float] = 0.5  # chosen: shortest time between two masks
