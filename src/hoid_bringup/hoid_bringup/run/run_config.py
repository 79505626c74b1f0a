"""Configuration of a whole run: the configurations of the four nodes as its sections."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from hoid_bringup.run.parameter_names import by_node, full_names
from hoid_common.config import Config, section
from hoid_common.errors import ConfigError
from hoid_detector.config import DetectorNodeConfig
from hoid_filter.config import ExtractionConfig, FilterNodeConfig
from hoid_filter.strategy import needs_detections
from hoid_scene.config.scene_config import SceneNodeConfig
from rgbd_slam.config.node_config import SlamNodeConfig

TRUTH = 'truth'
"""Value of `detector.model` for the ground-truth boxes of a rendered bag instead of a detector."""
NO_TRUTH = (
    f'has no ground-truth boxes for "--detector {TRUTH}"; use a bag of "hoid synth", or a detector'
)
SHORT_NAMES = {'filter': 'filter.strategy', 'seed': 'slam.seed'}
"""Short names of parameters that every summary contains, whether they were changed or not."""


@dataclass(frozen=True)
class RunConfig(Config):
    """Parameters of an offline run or a replay, with the same names as in the nodes.

    ConfigError if a value is out of range, or SLAM cannot use the features of the filter.
    """

    detector: DetectorNodeConfig = section(DetectorNodeConfig)  # its `model` may be TRUTH
    filter: FilterNodeConfig = section(FilterNodeConfig)
    slam: SlamNodeConfig = section(SlamNodeConfig)
    scene: SceneNodeConfig = section(SceneNodeConfig)

    # Prefixes of the names of parameters that have no effect offline.
    LIVE_ONLY: ClassVar[tuple[str, ...]] = (
        'detector.input.', 'detector.base_frame', 'detector.autostart',
        'filter.input.',
        'filter.detections.', 'slam.input.', 'slam.frames.', 'slam.map_',
        'slam.mode', 'scene.input.', 'scene.map_', 'scene.navigation.',
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        camera = self.slam.camera
        levels, scale = ExtractionConfig.num_levels, ExtractionConfig.scale_factor
        if camera.num_octaves < levels or camera.scale_factor != scale:
            raise ConfigError(
                f'slam.camera.num_octaves, {camera.num_octaves}, must be at least {levels}, and '
                f'slam.camera.scale_factor, {camera.scale_factor:g}, must be {scale}, because the '
                'features of the filter have such octaves'
            )

    @property
    def needs_detections(self) -> bool:
        return needs_detections(self.filter)

    @property
    def live_only(self) -> list[str]:
        """Return the names of changed parameters that have no effect offline."""
        return [name for name in self.changed() if name.startswith(self.LIVE_ONLY)]

    def updated(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with new values, by any name that `full_names` accepts."""
        known = self.values()
        return super().updated(
            {full: v for name, v in values.items() for full in full_names(name, known)}
        )

    def changed(self) -> dict[str, Any]:
        """Return the parameters that are not at their defaults, by dotted name."""
        default = RunConfig().values()
        return {name: value for name, value in self.values().items() if value != default[name]}

    def named(self, names: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Return the values of the named parameters, by node and by their name in the node."""
        values = self.values()
        return by_node({full: values[full] for n in names for full in full_names(n, values)})

    def summary_options(self) -> dict[str, Any]:
        """Return the options for a summary: strategy, seed, and all changed parameters."""
        values = self.values()
        always = {short: values[name] for short, name in SHORT_NAMES.items()}
        rest = {n: v for n, v in self.changed().items() if n not in SHORT_NAMES.values()}
        return {**always, **rest}

    @classmethod
    def from_summary_options(cls, options: Mapping[str, Any]) -> RunConfig:
        """Return the configuration of a run that the options in its summary describe.

        It ignores options that are no parameters of this version, such as the rate of a replay.
        """
        values: dict[str, Any] = {}
        known = cls().values()
        for name, value in options.items():
            with suppress(ConfigError):
                for full in full_names(SHORT_NAMES.get(name, name), known):
                    values[full] = tuple(value) if isinstance(value, list) else value
        return cls().updated(values)
