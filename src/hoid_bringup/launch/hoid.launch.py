"""The whole suite: detector, filter and SLAM, in a namespace, for a camera chosen by name.

ros2 launch hoid_bringup hoid.launch.py camera:=realsense base_frame:=base_link

`./hoid nodes` keeps discovery to this computer and takes the suite's transport profile; under
launch both are the shell's matter:

export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
share=$(ros2 pkg prefix --share hoid_common)
export FASTRTPS_DEFAULT_PROFILES_FILE=$share/config/fastdds_profile.xml

With the camera on another computer it is SUBNET and fastdds_network_profile.xml, on both.
"""

from __future__ import annotations

from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.substitutions import FindPackageShare

from hoid_bringup.live.camera_topics import CAMERA_TOPICS
from hoid_common import topics
from hoid_common.ros.launch_files import (
    Argument,
    common_arguments,
    is_on,
    suite_node,
    switch,
    value,
)
from hoid_filter.config import FilterConfig
from hoid_filter.strategy_registry import STRATEGIES
from launch import LaunchContext, LaunchDescription

RVIZ = PathJoinSubstitution([FindPackageShare('hoid_bringup'), 'rviz', 'hoid.rviz'])
# Launch argument that names a topic: the suite's own name of it.
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
        description='driver whose topics are taken',
    ),
    Argument(
        'camera_namespace', default_value='', description="of the driver; empty: the driver's own"
    ),
    *(
        Argument(name, default_value='', description=f"in place of the camera's {topic}")
        for name, topic in CAMERA_ARGUMENTS.items()
    ),
    Argument('map_topic', default_value=topics.GRID_MAP, description='of the occupancy grid'),
    Argument('model', default_value='', description='ONNX file; empty: the usual places'),
    Argument(
        'strategy',
        default_value=FilterConfig().strategy,
        choices=list(STRATEGIES),
        description='how dynamic objects are told',
    ),
    Argument('base_frame', default_value='', description="the robot's; empty: the camera's own"),
    switch('detector', 'run it here', default=True),
    switch('rviz', 'open RViz'),
)


def camera_remappings(context: LaunchContext) -> list[tuple[str, str]]:
    """Return the remaps of the camera's topics, each by its own argument or as the preset says."""
    preset = CAMERA_TOPICS[value(context, 'camera')]
    names = dict(preset.remappings(value(context, 'camera_namespace')))
    return topics.camera_remappings(
        *(value(context, name) or names[topic] for name, topic in CAMERA_ARGUMENTS.items())
    )


def suite(context: LaunchContext) -> list[LifecycleNode | Node]:
    """Make the nodes; the camera's name is known only now."""
    camera = camera_remappings(context)
    grid = (topics.GRID_MAP, value(context, 'map_topic'))
    parameters = {
        'hoid_detector': {'model': value(context, 'model')},
        'hoid_filter': {'strategy': value(context, 'strategy')},
        'rgbd_slam': {'frames.base': value(context, 'base_frame')},
    }
    if not is_on(context, 'detector'):
        del parameters['hoid_detector']
    nodes = [
        suite_node(context, package, own, [*camera, grid]) for package, own in parameters.items()
    ]
    return [*nodes, rviz()] if is_on(context, 'rviz') else nodes


def rviz() -> Node:
    """Return RViz with the suite's displays."""
    return Node(
        package='rviz2',
        executable='rviz2',
        namespace=LaunchConfiguration('namespace'),
        arguments=['-d', RVIZ],
        remappings=list(topics.NAMESPACED_TF),
    )


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the nodes."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=suite)])
