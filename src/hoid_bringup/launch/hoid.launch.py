"""Launches detector, filter, SLAM and scene for a camera driver that is chosen by name.

./hoid env ros2 launch hoid_bringup hoid.launch.py camera:=realsense base_frame:=base_link

`./hoid env` sets the Python environment of the nodes, limits discovery to this computer, and sets
the transport profile of the suite. In another environment that has their packages, set both in the
shell:

export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
share=$(ros2 pkg prefix --share hoid_common)
export FASTRTPS_DEFAULT_PROFILES_FILE=$share/config/fastdds_profile.xml

If the camera is on another computer, use SUBNET and fastdds_network_profile.xml on both.
"""

from __future__ import annotations

from ament_index_python import PackageNotFoundError, get_package_share_directory
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.substitutions import FindPackageShare

from hoid_common import topics
from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_common.ros.launch_files import (
    Argument,
    common_arguments,
    is_on,
    suite_node,
    switch,
    tf_remappings,
    value,
)
from hoid_filter.config import FilterConfig
from hoid_filter.strategy_registry import STRATEGIES
from launch import LaunchContext, LaunchDescription

RVIZ = PathJoinSubstitution([FindPackageShare('hoid_bringup'), 'rviz', 'hoid.rviz'])
# By launch argument: the nodes' name for the camera topic that the argument sets.
CAMERA_ARGUMENTS = {
    'rgb_topic': topics.RGB_IMAGE,
    'depth_topic': topics.DEPTH_IMAGE,
    'camera_info_topic': topics.CAMERA_INFO,
}
ARGUMENTS = (
    *common_arguments('hoid_bringup', 'hoid.yaml'),
    Argument(
        'camera',
        default_value='bag',
        choices=list(CAMERA_TOPICS),
        description='camera driver whose topics the nodes subscribe to',
    ),
    Argument(
        'camera_namespace',
        default_value='',
        description="namespace of the camera driver; empty: the driver's own default",
    ),
    *(
        Argument(
            name,
            default_value='',
            description=f'topic of the camera for {topic}; empty: that of the driver',
        )
        for name, topic in CAMERA_ARGUMENTS.items()
    ),
    Argument(
        'map_topic',
        default_value=topics.GRID_MAP,
        description='topic of the occupancy grid; its updates are on <map_topic>_updates',
    ),
    Argument(
        'model', default_value='', description='ONNX model of the detector; empty: search for one'
    ),
    Argument(
        'strategy',
        default_value=FilterConfig().strategy,
        choices=list(STRATEGIES),
        description='strategy that identifies dynamic objects',
    ),
    Argument(
        'base_frame',
        default_value='',
        description='base frame of the robot; empty: the optical frame of the camera',
    ),
    switch('detector', 'whether to run the detector', default=True),
    switch('scene', 'whether to map the scene: grid, people and objects', default=True),
    switch('rviz', 'whether to open RViz'),
)


def camera_remappings(context: LaunchContext) -> list[tuple[str, str]]:
    """Return the remappings (from, to) of the camera topics.

    Each camera topic comes from its launch argument or, if that is empty, from the driver.
    """
    preset = CAMERA_TOPICS[value(context, 'camera')]
    names = dict(preset.remappings(value(context, 'camera_namespace')))
    return topics.camera_remappings(
        *(value(context, name) or names[topic] for name, topic in CAMERA_ARGUMENTS.items())
    )


def suite(context: LaunchContext) -> list[LifecycleNode | Node]:
    camera = camera_remappings(context)
    grid = value(context, 'map_topic')
    grids = [(topics.GRID_MAP, grid), (topics.GRID_MAP_UPDATES, f'{grid}_updates')]
    parameters = {
        'hoid_detector': {
            'model': value(context, 'model'),
            'base_frame': value(context, 'base_frame'),
        },
        'hoid_filter': {'strategy': value(context, 'strategy')},
        'rgbd_slam': {'frames.base': value(context, 'base_frame')},
        'hoid_scene': {},
    }
    for name in ('detector', 'scene'):
        if not is_on(context, name):
            del parameters[f'hoid_{name}']
    viewers = [rviz(context)] if is_on(context, 'rviz') else []
    nodes = [
        suite_node(context, package, values, [*camera, *grids])
        for package, values in parameters.items()
    ]
    return [*nodes, *viewers]


def rviz(context: LaunchContext) -> Node:
    """Return RViz with the displays of the suite.

    RuntimeError if RViz is not installed; the launch then ends before it has started a node.
    """
    try:
        get_package_share_directory('rviz2')
    except PackageNotFoundError:
        raise RuntimeError(
            'rviz:=true needs the package rviz2, which is not installed: install '
            'ros-jazzy-rviz2, or leave rviz at false'
        ) from None
    return Node(
        package='rviz2',
        executable='rviz2',
        namespace=LaunchConfiguration('namespace'),
        arguments=['-d', RVIZ],
        remappings=tf_remappings(context),
    )


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=suite)])
