"""Parameters of the tracks of people and objects, and of the object map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param
from hoid_common.errors import ConfigError
from hoid_common.values import REST_S


@dataclass(frozen=True)
class ObjectTrackerConfig(Config):
    """Tracking of people and objects in the map frame."""

    enabled: bool = param(
        default=True,
        description='Whether to track people and objects in 3-D and to publish them on '
        'tracked_objects and people. Set it to false to save time if neither these topics, '
        'navigation.enabled nor the people who handle mapped objects are needed.',
    )
    rate_hz: float = param(
        10.0,
        'Largest rate at which images are used to track people and objects (Hz). Raise it to '
        'follow fast people better.',
        limits=(0.1, 60.0),
        read_only=False,
        expert=True,
    )
    # Time for which an object must be seen at one place before it counts as at rest.
    rest_s: ClassVar[float] = REST_S
    # Least number of detections of a published track; a track with fewer may be a false detection.
    min_sightings: ClassVar[int] = 3
    # If there are more tracks, those that were not detected for longest end. Chosen, to bound the
    # memory.
    max_objects: ClassVar[int] = 200
    # Not tuned: largest distance at which a detection is assigned to the nearest track of its
    # class, from the predicted position of the track; and the same distance if object and track
    # are at rest. A handled object may have been carried farther (see `ObjectTracker`).
    gate_m: ClassVar[float] = 0.7
    rest_gate_m: ClassVar[float] = 0.35
    measurement_sigma_m: ClassVar[float] = 0.08  # standard deviation of a measured center
    # Process noise of the Kalman filter: standard deviation of the acceleration along each axis of
    # people and of objects that are not at rest. Chosen for people.
    acceleration_sigma_mps2: ClassVar[float] = 3.0
    # Times without a detection after which a track ends. The first holds for people, objects in
    # motion and tracks that are not published yet, the second for objects at rest.
    forget_moving_s: ClassVar[float] = 1.0
    forget_resting_s: ClassVar[float] = 600.0
    # Time since its last detection for which an object that was taken away (carried out of sight,
    # or gone from its place of rest) keeps its track, so that it is recognized when it is put down
    # elsewhere.
    forget_taken_s: ClassVar[float] = 60.0
    # Distance beyond which an object counts as moved. Farther from its place of rest, an object
    # that the filter calls dynamic becomes handled and, once put down, MOVED instead of AT_REST.
    # Farther from where it last stood still, it counts as still being carried.
    moved_m: ClassVar[float] = 0.12


@dataclass(frozen=True)
class ObjectMapConfig(Config):
    """The map of the objects at rest: each object once, with its place and its history."""

    enabled: bool = param(
        default=False,  # decision 052: most robots do not use it
        description='Whether to keep a map of the objects at rest and to publish it on '
        'object_map. It takes about 3 % of a processor core, and needs a detector; without '
        'objects.enabled it does not show which objects people handle.',
        expert=True,
    )
    label_cloud: bool = param(
        default=False,  # decision 052: few nodes read it, and a point takes 4 bytes more
        description='Whether each point of cloud_map has the class of its object in a field label '
        '(uint32, 0: no object), whose names are on cloud_map/labels. It needs object_map.enabled '
        'and dense.enabled.',
        expert=True,
    )

    prior_score: float = param(
        0.0,  # decision 052
        'Lowest score, from 0 to 1, of the detections that confirm the object map, if the '
        'detector uses the map as its prior. Set it to the score_threshold of hoid_detector, and '
        'set expected_score_threshold of hoid_detector to a lower value. With 0, all detections '
        'confirm the map, and expected_objects is not published.',
        limits=(0.0, 1.0),
        expert=True,
    )

    # Largest rate (Hz) of the images that are used for all objects: in six rooms, as good as 10
    # (decision 052). Images with detections between them, up to the second rate, are used only
    # for objects in view that are not confirmed yet.
    look_rate_hz: ClassVar[float] = 3.0
    evidence_rate_hz: ClassVar[float] = 10.0
    # Larger than the rate of cameras: the map chooses among all images, because only some of them
    # have detections.
    rate_hz: ClassVar[float] = 100.0

    def __post_init__(self) -> None:
        """Raise ConfigError if a value is invalid, or `label_cloud` is on without object map."""
        super().__post_init__()
        if self.label_cloud and not self.enabled:
            raise ConfigError('object_map.label_cloud needs object_map.enabled')
