"""Parameters of the SLAM node: those of the core, and how it meets a robot."""

from __future__ import annotations

from dataclasses import dataclass, field

from hoid_common.config import Config, param
from hoid_common.input_config import InputConfig
from hoid_common.slam_status import SlamMode
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.config.slam_config import SlamConfig


@dataclass(frozen=True)
class FrameConfig(Config):
    """The frame tree map -> odom -> base (REP 105)."""

    map: str = param('map', 'Name of the map frame')
    odom: str = param('odom', 'Name of the odometry frame')
    base: str = param(
        '',
        "The robot's base, found from the camera's frame on /tf_static; empty: the camera's own "
        'optical frame takes its place',
    )
    publish_map_to_odom: bool = param(
        default=True, description='Send map -> odom on /tf', read_only=False
    )
    publish_odom_to_base: bool = param(
        default=True, description='Send odom -> base on /tf', read_only=False
    )
    planar: bool = param(
        default=False, description='The base moves on a plane: no height, no roll, no pitch'
    )


@dataclass(frozen=True)
class SlamNodeConfig(SlamConfig):
    """All parameters of the node; those of the core keep their names."""

    map_directory: str = param(
        '~/.ros/hoid', 'Folder of the files that services read and write; none lie outside'
    )
    map_file: str = param(
        '', 'Map in that folder to start with, saved before by save_map; empty: an empty map'
    )
    mode: str = param(
        SlamMode.MAPPING.name.lower(), 'To start in: localization needs a map_file',
        choices=tuple(mode.name.lower() for mode in SlamMode),
    )  # fmt: skip
    map_period_s: float = param(
        1.0, 'Map, path and keyframes are published at most so often', minimum=0.05,
        maximum=3600.0, read_only=False,
    )  # fmt: skip
    frames: FrameConfig = field(default_factory=FrameConfig)
    input: InputConfig = field(default_factory=InputConfig)
    dense: DenseConfig = field(default_factory=DenseConfig)
    objects: ObjectTrackerConfig = field(default_factory=ObjectTrackerConfig)
