"""The whole suite: detector, filter and SLAM, in a namespace, for a camera chosen by name.

ros2 launch hoid_bringup hoid.launch.py camera:=realsense base_frame:=base_link
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

from hoid_bringup.live.camera_topics import CAMERA_TOPICS
from hoid_common.topics import NAMESPACED_TF
from hoid_filter.config import FilterConfig
from launch import LaunchContext, LaunchDescription

STRATEGY = FilterConfig().strategy
PARAMS = PathJoinSubstitution([FindPackageShare('hoid_bringup'), 'config', 'hoid.yaml'])
RVIZ = PathJoinSubstitution([FindPackageShare('hoid_bringup'), 'rviz', 'hoid.rviz'])
ARGUMENTS = (
    DeclareLaunchArgument(
        'namespace', default_value='', description='of nodes, topics and the frame tree on tf'
    ),
    DeclareLaunchArgument('params_file', default_value=PARAMS, description='parameters, YAML'),
    DeclareLaunchArgument(
        'camera',
        default_value='bag',
        choices=list(CAMERA_TOPICS),
        description='driver whose topics are taken',
    ),
    DeclareLaunchArgument('use_sim_time', default_value='false', description='take /clock'),
    DeclareLaunchArgument(
        'model', default_value='', description='detector, an ONNX file; empty: the usual places'
    ),
    DeclareLaunchArgument('strategy', default_value=STRATEGY, description='of the filter'),
    DeclareLaunchArgument(
        'base_frame', default_value='', description="the robot's; empty: the camera's own"
    ),
    DeclareLaunchArgument('detector', default_value='true', description='run it here'),
    DeclareLaunchArgument('rviz', default_value='false', description='open RViz'),
    DeclareLaunchArgument('log_level', default_value='info'),
)


def text(name: str) -> ParameterValue:
    """Return a launch argument that stays a string, also when it looks like a number."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def suite(context: LaunchContext) -> list[Node]:
    """Make the nodes; the camera's name is known only now."""
    camera = LaunchConfiguration('camera').perform(context)
    common = {
        'namespace': LaunchConfiguration('namespace'),
        'remappings': [*CAMERA_TOPICS[camera].remappings(), *NAMESPACED_TF],
        'output': 'screen',
        'arguments': ['--ros-args', '--log-level', LaunchConfiguration('log_level')],
    }
    shared = [
        ParameterFile(LaunchConfiguration('params_file'), allow_substs=True),
        {'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)},
    ]
    return [
        # A lifecycle node that activates itself (autostart), so that it needs no manager.
        LifecycleNode(
            package='hoid_detector',
            executable='hoid_detector_node',
            name='hoid_detector',
            parameters=[*shared, {'model': text('model')}],
            condition=IfCondition(LaunchConfiguration('detector')),
            **common,
        ),
        Node(
            package='hoid_filter',
            executable='hoid_filter_node',
            name='hoid_filter',
            parameters=[*shared, {'strategy': text('strategy')}],
            **common,
        ),
        Node(
            package='rgbd_slam',
            executable='rgbd_slam_node',
            name='rgbd_slam',
            parameters=[*shared, {'frames.base': text('base_frame')}],
            **common,
        ),
        Node(
            package='rviz2',
            executable='rviz2',
            namespace=LaunchConfiguration('namespace'),
            arguments=['-d', RVIZ],
            remappings=list(NAMESPACED_TF),
            condition=IfCondition(LaunchConfiguration('rviz')),
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the nodes."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=suite)])
