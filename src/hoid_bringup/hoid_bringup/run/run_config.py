"""One configuration for a whole run: the stages' own, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from hoid_common.config import Config, param
from hoid_common.errors import ConfigError
from hoid_detector.config import DetectorConfig
from hoid_filter.config import ExtractionConfig, FilterConfig
from hoid_filter.detections.detection_gate import GateConfig
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.config.slam_config import CameraConfig, SlamConfig

TRUTH = 'truth'
"""As a model: the exact boxes that a rendered bag brings, in place of a detector's."""
SHORT_NAMES = {'filter': 'filter.strategy', 'seed': 'slam.seed'}
"""What people ask for by a short name, and read of a run whether they changed it or not."""


@dataclass(frozen=True)
class RunConfig(Config):
    """Parameters of an offline run or a replay; nested names are those of the nodes.

    SLAM's octaves follow the filter's unless they are set, too.

    Raises:
        ConfigError: A value is out of range, or the octaves of filter and SLAM do not agree.
    """

    model: str = param('', f'Detector model file, "{TRUTH}", or empty for the usual places')
    detector: DetectorConfig = field(default_factory=DetectorConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    detections: GateConfig = field(default_factory=GateConfig)  # live; offline, all are waited for
    slam: SlamConfig = field(default_factory=SlamConfig)
    dense: DenseConfig = field(default_factory=DenseConfig)
    objects: ObjectTrackerConfig = field(default_factory=ObjectTrackerConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        camera = _following(self.slam.camera, self.filter.extraction)
        object.__setattr__(self, 'slam', replace(self.slam, camera=camera))

    @property
    def needs_detections(self) -> bool:
        """Return whether the filter looks at boxes at all."""
        return self.filter.strategy != 'none'

    def changed(self) -> dict[str, Any]:
        """Return the parameters that are not at their defaults, by dotted name."""
        default = {p.name: p.value for p in RunConfig().params()}
        return {p.name: p.value for p in self.params() if p.value != default[p.name]}

    def noted(self) -> dict[str, Any]:
        """Return what a summary says of a run: strategy, seed, and what else was changed."""
        values = {p.name: p.value for p in self.params()}
        always = {short: values[name] for short, name in SHORT_NAMES.items()}
        rest = {n: v for n, v in self.changed().items() if n not in SHORT_NAMES.values()}
        return {**always, **rest}

    @classmethod
    def from_noted(cls, noted: Mapping[str, Any]) -> RunConfig:
        """Return the configuration that a summary notes, as read from JSON.

        What is no parameter, as of a replay or of another version, is left out.
        """
        known = {p.name for p in cls().params()}
        named = {SHORT_NAMES.get(name, name): value for name, value in noted.items()}
        values = {name: value for name, value in named.items() if name in known}
        return cls().updated(
            {n: tuple(v) if isinstance(v, list) else v for n, v in values.items()}
        )


def _following(camera: CameraConfig, extraction: ExtractionConfig) -> CameraConfig:
    """Return SLAM's camera with the octaves of the features that the filter makes."""
    default = CameraConfig()
    if camera.num_octaves == default.num_octaves:
        camera = replace(camera, num_octaves=max(extraction.num_levels, default.num_octaves))
    if camera.scale_factor == default.scale_factor:
        camera = replace(camera, scale_factor=extraction.scale_factor)
    if extraction.num_levels > camera.num_octaves:
        raise ConfigError(
            f'filter.extraction.num_levels, {extraction.num_levels}, must not be beyond '
            f'slam.camera.num_octaves, {camera.num_octaves}'
        )
    if extraction.scale_factor != camera.scale_factor:
        raise ConfigError(
            f'filter.extraction.scale_factor, {extraction.scale_factor:g}, must be '
            f'slam.camera.scale_factor, {camera.scale_factor:g}'
        )
    return camera
