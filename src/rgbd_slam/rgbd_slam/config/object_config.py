"""Parameters of the tracks of people and objects."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ObjectTrackerConfig(Config):
    """Tracking of people and objects in the map frame."""

    enabled: bool = param(default=True, description='Follow people and objects in 3-D')
    rate_hz: float = param(
        10.0, 'Images looked at per second, at most', minimum=0.1, maximum=60.0, read_only=False
    )
    gate_m: float = param(0.7, 'A sighting farther from a track starts a new one', minimum=0.05)
    rest_gate_m: float = param(0.35, 'The same, for what nobody handles', minimum=0.05)
    measurement_sigma_m: float = param(0.08, 'Noise of a measured centre', minimum=0.001)
    acceleration_sigma_mps2: float = param(3.0, 'How abruptly people move', minimum=0.01)
    forget_moving_s: float = param(1.0, 'Unseen people and handled objects end', minimum=0.1)
    forget_resting_s: float = param(600.0, 'Unseen resting objects end', minimum=1.0)
    forget_taken_s: float = param(
        60.0, 'How long an object that went out of sight is known again when put down', minimum=0.0
    )
    reach_m: float = param(
        1.0, 'An object is handled only this near to a person, over the floor', minimum=0.1
    )
    rest_s: float = param(0.8, 'Seen still for so long, an object is at rest', minimum=0.0)
    moved_m: float = param(0.12, 'Farther from its place than this, it was moved', minimum=0.01)
    min_sightings: int = param(3, 'Sightings before a track is published', minimum=1)
    max_objects: int = param(200, 'Memory bound', minimum=1)
