"""Parameters of the SLAM node: those of the core, and how it meets a robot."""

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
        'Name of the odometry frame. Set it to that of the wheels where they send odom -> base.',
        expert=True,
    )
    base: str = param(
        '',
        "Name of the robot's base frame, which is found from the camera's frame on /tf_static; "
        "empty takes the camera's own optical frame. Set it on every robot, often to base_link.",
    )
    publish_map_to_odom: bool = param(
        default=True,
        description='Sends map -> odom on /tf; false where another node localises the robot.',
        read_only=False,
        expert=True,
    )
    publish_odom_to_base: bool = param(
        default=True,
        description='Sends odom -> base on /tf. Set it to false where the wheels or a filter of '
        'poses send it already: map -> odom then fits theirs, and the own odometry is on '
        'visual_odom.',
        read_only=False,
    )
    transform_tolerance_s: float = param(
        0.1,
        'Time by which map -> odom is dated ahead when somebody else sends odom -> base (s), so '
        'that it holds until the next one comes.',
        minimum=0.0, maximum=10.0, read_only=False, expert=True,
    )  # fmt: skip
    planar: bool = param(
        default=False,
        description='Keeps the base on a plane: no height, no roll, no pitch. Set it for a robot '
        'on wheels on a level floor.',
    )


@dataclass(frozen=True)
class SlamNodeConfig(NodeConfig, SlamConfig):
    """All parameters of the node; those of the core keep their names."""

    map_directory: str = param(
        '~/.ros/hoid',
        'Folder of the files that services read and write; none lie outside. Set it to keep maps '
        'elsewhere.',
    )
    map_file: str = param(
        '',
        'Map in that folder to start with, saved before by save_map; empty starts an empty map. '
        'Set it to go on in a known place.',
    )
    mode: str = param(
        SlamMode.MAPPING.name.lower(),
        'Whether to extend the map (mapping) or only to look for poses in that of map_file '
        '(localization). Choose the latter once the map is good.',
        choices=tuple(mode.name.lower() for mode in SlamMode),
    )
    checkpoint_period_s: float = param(
        10.0,
        'Time between two copies of the map that changes, in map_directory, which a node that '
        'starts after a crash goes on in (s). Set it to 0 for none.',
        minimum=0.0,
        maximum=3600.0,
        expert=True,
    )
    map_period_s: float = param(
        1.0, 'Shortest time between two maps, paths and keyframes that are published (s).',
        minimum=0.05, maximum=3600.0, read_only=False, expert=True,
    )  # fmt: skip
    frames: FrameConfig = section(FrameConfig)
    dense: DenseConfig = section(DenseConfig)
    objects: ObjectTrackerConfig = section(ObjectTrackerConfig)
