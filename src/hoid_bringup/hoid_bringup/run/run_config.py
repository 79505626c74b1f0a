"""One configuration for a whole run: the stages' own, side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from hoid_bringup.run.parameter_names import by_node, full_name
from hoid_common.config import Config, section
from hoid_common.errors import ConfigError
from hoid_detector.config import DetectorNodeConfig
from hoid_filter.config import ExtractionConfig
from hoid_filter.node_config import FilterNodeConfig
from hoid_filter.strategy import needs_detections
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.config.slam_config import CameraConfig

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

    detector: DetectorNodeConfig = section(DetectorNodeConfig)  # its model may be `TRUTH`
    filter: FilterNodeConfig = section(FilterNodeConfig)
    slam: SlamNodeConfig = section(SlamNodeConfig)

    LIVE_ONLY: ClassVar[tuple[str, ...]] = (  # beginnings of names that mean nothing offline
        'detector.input.', 'detector.niceness', 'detector.autostart', 'filter.input.',
        'filter.sync_slop_s', 'filter.detections.', 'slam.input.', 'slam.frames.', 'slam.map_',
        'slam.mode',
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        camera = _following(self.slam.camera, self.filter.extraction)
        object.__setattr__(self, 'slam', replace(self.slam, camera=camera))

    @property
    def needs_detections(self) -> bool:
        """Return whether the filter looks at boxes at all."""
        return needs_detections(self.filter)

    @property
    def live_only(self) -> list[str]:
        """Return the changed parameters that mean nothing offline."""
        return [name for name in self.changed() if name.startswith(self.LIVE_ONLY)]

    def updated(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with values replaced, under any of the names of `full_name`.

        Raises:
            ConfigError: A name is unknown or ambiguous, or a value is unusable.
        """
        known = [p.name for p in self.params()]
        return super().updated({full_name(name, known): v for name, v in values.items()})

    def changed(self) -> dict[str, Any]:
        """Return the parameters that are not at their defaults, by dotted name."""
        default = {p.name: p.value for p in RunConfig().params()}
        return {p.name: p.value for p in self.params() if p.value != default[p.name]}

    def changed_of_nodes(self) -> dict[str, dict[str, Any]]:
        """Return them by node and by the name that the node has for each."""
        return by_node(self.changed())

    def named(self, names: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Return parameters by node, whether they were changed or not.

        Raises:
            ConfigError: A name is unknown or ambiguous.
        """
        values = {p.name: p.value for p in self.params()}
        return by_node({full: values[full] for full in (full_name(n, values) for n in names)})

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
        values: dict[str, Any] = {}
        known = [p.name for p in cls().params()]
        for name, value in noted.items():
            with suppress(ConfigError):
                full = full_name(SHORT_NAMES.get(name, name), known)
                values[full] = tuple(value) if isinstance(value, list) else value
        return cls().updated(values)


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
