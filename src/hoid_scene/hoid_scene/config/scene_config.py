"""Configuration of the scene node: dense map, tracks, object map and masks."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section
from hoid_common.errors import ConfigError
from hoid_common.inputs.input_config import NodeConfig
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_scene.config.object_config import ObjectMapConfig, ObjectTrackerConfig


@dataclass(frozen=True)
class SceneConfig(Config):
    """Parameters of the scene mapper and of the masks for Nav2's costmap filters."""

    dense: DenseConfig = section(DenseConfig)
    objects: ObjectTrackerConfig = section(ObjectTrackerConfig)
    object_map: ObjectMapConfig = section(ObjectMapConfig)
    navigation: NavigationConfig = section(NavigationConfig)

    def __post_init__(self) -> None:
        """Raise ConfigError if a value is invalid, or navigation is on while objects are off."""
        super().__post_init__()
        if self.navigation.enabled and not self.objects.enabled:
            raise ConfigError('navigation.enabled needs objects.enabled')


@dataclass(frozen=True)
class SceneNodeConfig(NodeConfig, SceneConfig):
    """All parameters of the scene node; those of the core (`SceneConfig`) keep their names."""

    map_directory: str = param(
        '~/.ros/hoid',
        'The only folder in which services write files. It also contains the images from which '
        'the dense map is restored after a crash. Set it to that of rgbd_slam, if both run on one '
        'computer.',
    )
