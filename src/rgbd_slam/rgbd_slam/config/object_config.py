"""Parameters of the tracks of people and objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ObjectTrackerConfig(Config):
    """Tracking of people and objects in the map frame."""

    enabled: bool = param(
        default=True,
        description='Follows people and objects in 3-D and publishes them as tracked_objects. Set '
        'it to false to save time where nobody listens.',
    )
    rate_hz: float = param(
        10.0, 'Images that are looked at per second, at most (Hz).',
        minimum=0.1, maximum=60.0, read_only=False, expert=True,
    )  # fmt: skip
    reach_m: float = param(
        1.0, 'An object is handled only this near to a person, over the floor (m).',
        minimum=0.1, expert=True,
    )  # fmt: skip
    rest_s: float = param(
        0.8, 'How long an object is seen still before it counts as at rest (s).',
        minimum=0.0, expert=True,
    )  # fmt: skip
    min_sightings: int = param(
        3, 'Number of sightings before a track is published.', minimum=1, expert=True
    )
    max_objects: int = param(
        200, 'Largest number of tracks, which bounds the memory.', minimum=1, expert=True
    )

    gate_m: ClassVar[float] = 0.7  # a sighting farther from a track starts a new one,
    rest_gate_m: ClassVar[float] = 0.35  # and farther from what nobody handles
    measurement_sigma_m: ClassVar[float] = 0.08  # noise of a measured centre
    acceleration_sigma_mps2: ClassVar[float] = 3.0  # how abruptly people move
    forget_moving_s: ClassVar[float] = 1.0  # unseen people and handled objects end,
    forget_resting_s: ClassVar[float] = 600.0  # and unseen resting ones
    # How long an object that went out of sight is known again when put down.
    forget_taken_s: ClassVar[float] = 60.0
    moved_m: ClassVar[float] = 0.12  # farther from its place than this, an object was moved
