"""Parameters of the SLAM node: those of the core, the frames, and the scene mapper."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section
from hoid_common.inputs.input_config import NodeConfig
from hoid_common.slam_status import SlamMode
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.config.slam_config import SlamConfig


@dataclass(frozen=True)
class FrameConfig(Config):
    """The frame tree map -> odom -> base (REP 105)."""

    map: str = param('map', 'Name of the map frame.', expert=True)
    odom: str = param(
        'odom',
        'Name of the odometry frame. If the wheels send odom -> base, it is their frame.',
        expert=True,
    )
    base: str = param(
        '',
        "Name of the robot's base frame, whose pose relative to the camera is read from "
        "/tf_static; empty uses the camera's own optical frame. Set it on every robot, often to "
        'base_link.',
    )
    publish_map_to_odom: bool = param(
        default=True,
        description='Sends map -> odom on /tf. It is off where another node localizes the robot.',
        read_only=False,
        expert=True,
    )
    publish_odom_to_base: bool = param(
        default=True,
        description='Sends odom -> base on /tf. Set it to false if the wheels or a filter of '
        'poses send it already: map -> odom is then relative to theirs, and the visual odometry '
        'is published on visual_odom.',
        read_only=False,
    )
    transform_tolerance_s: float = param(
        0.1,  # chosen: three images at 30 Hz; AMCL's transform_tolerance is 1.0
        'Time by which map -> odom is dated into the future while another node sends odom -> base '
        '(s). A longer time keeps the transform valid over missing images, and delays a '
        'correction by as much.',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
        expert=True,
    )
    planar: bool = param(
        default=False,
        description='Keeps the base on a plane, without height, roll or pitch. Set it for a robot '
        'on wheels on a level floor.',
    )


@dataclass(frozen=True)
class SlamNodeConfig(NodeConfig, SlamConfig):
    """All parameters of the node; those of the core keep their names."""

    map_directory: str = param(
        '~/.ros/hoid',
        'Folder of the files that services read and write; they use no other one. Set it to store '
        'maps elsewhere.',
    )
    map_file: str = param(
        '',
        'Map in map_directory that is loaded at the start, as saved by save_map; empty starts '
        'with an empty map. Set it to continue in a mapped place.',
    )
    mode: str = param(
        SlamMode.MAPPING.name.lower(),
        'Whether the map is extended (mapping) or only used to localize the robot '
        '(localization). Choose localization once the map is good.',
        choices=tuple(mode.name.lower() for mode in SlamMode),
    )
    checkpoint_period_s: float = param(
        10.0,  # decision 030
        'Time between two checkpoints of the map, from which a node resumes after a crash (s); 0 '
        'writes none. A longer period loses more of the map in a crash.',
        minimum=0.0,
        maximum=3600.0,
        expert=True,
    )
    map_period_s: float = param(
        1.0,  # chosen, for a display
        'Shortest time between two published maps, paths and keyframes (s). A longer period saves '
        'time and bandwidth.',
        minimum=0.05,
        maximum=3600.0,
        read_only=False,
        expert=True,
    )
    frames: FrameConfig = section(FrameConfig)
    dense: DenseConfig = section(DenseConfig)
    objects: ObjectTrackerConfig = section(ObjectTrackerConfig)
