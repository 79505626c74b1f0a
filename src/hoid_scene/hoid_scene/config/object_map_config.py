"""Parameters of the object map."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param
from hoid_common.errors import ConfigError


@dataclass(frozen=True)
class ObjectMapConfig(Config):
    """The map of the objects at rest: each object once, with its place and its history."""

    enabled: bool = param(
        default=False,  # decision 052: most robots do not use it
        description='Whether to keep a map of the objects at rest and to publish it on '
        'object_map. It needs a detector; without objects.enabled it does not show which objects '
        'people handle. Set it to true if a node uses the map; it takes about 3 % of a processor '
        'core.',
        expert=True,
    )
    rate_hz: float = param(
        3.0,  # decision 052: as good as 10 in a trial on six rendered rooms
        'Largest rate at which images are used for the object map (Hz). Raise it if the camera '
        'moves fast past the objects; it takes more processor time.',
        limits=(0.1, 10.0),
        read_only=False,
        expert=True,
    )
    label_cloud: bool = param(
        default=False,  # decision 052: few nodes read it, and a point takes 4 bytes more
        description='Whether each point of cloud_map has the class of its object in a field label '
        '(uint32, 0: no object); the names of the classes are published on cloud_map/labels. Set '
        'it to true if a node uses the labels. It is refused without object_map.enabled, and has '
        'no effect without dense.enabled.',
        expert=True,
    )

    prior_score: float = param(
        0.0,  # decision 052
        'Lowest score, from 0 to 1, of the detections that the object map uses, if the detector '
        'uses the map as its prior. The boxes in which known objects should be seen are then '
        'published on expected_objects, and weak detections that are reported only because of '
        'them do not confirm the map. Set it to score_threshold of hoid_detector, and set '
        'expected_score_threshold there as well. With 0, all detections are used, and nothing is '
        'published on expected_objects.',
        limits=(0.0, 1.0),
        expert=True,
    )

    def __post_init__(self) -> None:
        """Raise ConfigError if a value is invalid, or `label_cloud` is on without object map."""
        super().__post_init__()
        if self.label_cloud and not self.enabled:
            raise ConfigError('object_map.label_cloud needs object_map.enabled')
