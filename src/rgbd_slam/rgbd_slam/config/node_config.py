"""Parameters of the SLAM node: those of SLAM itself, frames and files."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section
from hoid_common.inputs.input_config import NodeConfig
from hoid_common.slam_status import SlamMode
from rgbd_slam.config.slam_config import SlamConfig


@dataclass(frozen=True)
class FrameConfig(Config):
    """The frame tree map -> odom -> base (REP 105)."""

    map: str = param(
        'map',
        'Name of the map frame. Change it if another map of the robot has this name.',
        expert=True,
    )
    odom: str = param(
        'odom',
        'Name of the odometry frame. If another node sends odom -> base, set it to the parent '
        'frame of that transform.',
        expert=True,
    )
    base: str = param(
        '',
        "Name of the robot's base frame, whose pose relative to the camera is read from "
        '/tf_static. Set it on every robot, usually to base_link. If it is empty, the optical '
        'frame of the camera takes the place of the base.',
    )
    publish_map_to_odom: bool = param(
        default=True,
        description='Whether to send map -> odom on /tf. Set it to false if another node sends '
        'it.',
        read_only=False,
        expert=True,
    )
    publish_odom_to_base: bool = param(
        default=True,
        description='Whether to send odom -> base on /tf. Set it to false if another node, such '
        'as robot_localization, sends it: that transform then also predicts the camera pose, and '
        'the visual odometry is on visual_odom. Do not feed visual_odom into the other node, '
        'which would receive its own estimate while the camera is lost.',
    )
    transform_tolerance_s: float = param(
        0.1,  # chosen: three images at 30 Hz; AMCL's transform_tolerance is 1.0
        'Time by which map -> odom is dated into the future while frames.publish_odom_to_base is '
        'false (s). Set a longer time if other nodes report that map -> odom is too old; '
        'corrections then take effect later by this time.',
        limits=(0.0, 10.0),
        read_only=False,
        expert=True,
    )
    planar: bool = param(
        default=False,
        description='Whether to publish odometry and /tf on the plane z = 0, without roll and '
        'pitch; path, map and saved trajectories stay in 3-D. Set it to true for a robot on '
        'wheels on a level floor. It needs frames.base, and replaces imu.level.',
    )


@dataclass(frozen=True)
class SlamNodeConfig(NodeConfig, SlamConfig):
    """All parameters of the node. Those of `SlamConfig` keep their names."""

    map_directory: str = param(
        '~/.ros/hoid',
        'The only folder in which services read and write files. It also contains map_file and '
        'the map of the running node.',
    )
    map_file: str = param(
        '',
        'File in map_directory, saved by save_map, whose map is loaded at the start. If it is '
        'empty, no map is loaded. In the mode mapping, a node that crashed resumes from its '
        'checkpoint instead, if the camera fits and the stamps of the images do not go back.',
    )
    mode: str = param(
        SlamMode.MAPPING.name.lower(),
        'What the node does at the start: mapping extends the map, localization only localizes '
        'the robot in the map of map_file and writes no checkpoints. Choose localization once the '
        'map is complete.',
        choices=tuple(mode.name.lower() for mode in SlamMode),
    )
    checkpoint_period_s: float = param(
        10.0,  # decision 030
        'Usual time between two checkpoints, from which a node that crashed resumes (s), longer '
        'if writing is slow. With 0, or if the node starts with the mode localization, no map is '
        'written, resumed, or kept at the end.',
        limits=(0.0, 3600.0),
        expert=True,
    )
    map_period_s: float = param(
        1.0,  # chosen, for a display
        'Usual time between two messages on map_points, path and keyframes (s), which are sent '
        'when the map has changed. It is longer if making them takes more than 5 % of a processor '
        'core.',
        limits=(0.05, 3600.0),
        read_only=False,
        expert=True,
    )
    frames: FrameConfig = section(FrameConfig)
