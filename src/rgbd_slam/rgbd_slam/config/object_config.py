"""Parameters of the tracks of people and objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ObjectTrackerConfig(Config):
    """Tracking of people and objects in the map frame.

    Where no other source is named, the values were chosen for people and things in rooms and are
    not tuned.
    """

    enabled: bool = param(
        default=True,
        description='Tracks people and objects in 3-D and publishes them as tracked_objects. Set '
        'it to false to save time where nobody subscribes.',
    )
    rate_hz: float = param(
        10.0,
        'Largest rate of the images in which objects are tracked (Hz). A higher rate follows fast '
        'people better and takes more time.',
        minimum=0.1,
        maximum=60.0,
        read_only=False,
        expert=True,
    )
    # Time for which an object must be seen at one place before it counts as at rest.
    rest_s: ClassVar[float] = 0.8
    min_sightings: ClassVar[int] = 3  # after which a track is published; fewer may be false
    # Chosen, to bound the memory: number of tracks beyond which those unseen for longest end.
    max_objects: ClassVar[int] = 200
    gate_m: ClassVar[float] = 0.7  # a sighting farther from a track starts a new track
    rest_gate_m: ClassVar[float] = 0.35  # the same for a track that nobody handles
    measurement_sigma_m: ClassVar[float] = 0.08  # standard deviation of a measured center
    acceleration_sigma_mps2: ClassVar[float] = 3.0  # process noise: how abruptly people move
    forget_moving_s: ClassVar[float] = 1.0  # after which unseen people and handled objects end
    forget_resting_s: ClassVar[float] = 600.0  # after which unseen objects at rest end
    # Time for which an object that was carried out of sight is recognized when it is put down.
    forget_taken_s: ClassVar[float] = 60.0
    moved_m: ClassVar[float] = 0.12  # displacement from which an object counts as moved
    # Distance over the floor up to which a person can handle an object (m). A larger value marks
    # more objects near people as handled (chosen: the reach of an arm and a step).
    reach_m: ClassVar[float] = 1.0
