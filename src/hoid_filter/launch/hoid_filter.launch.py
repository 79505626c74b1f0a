"""The filter alone.

ros2 launch hoid_filter hoid_filter.launch.py strategy:=hoid2d image:=/camera/color/image_raw
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

from hoid_filter.config import FilterConfig
from launch import LaunchDescription

PARAMS = PathJoinSubstitution([FindPackageShare('hoid_filter'), 'config', 'hoid_filter.yaml'])


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the node."""
    image, depth = LaunchConfiguration('image'), LaunchConfiguration('depth')
    return LaunchDescription(
        [
            DeclareLaunchArgument('namespace', default_value=''),
            DeclareLaunchArgument('params_file', default_value=PARAMS),
            DeclareLaunchArgument('strategy', default_value=FilterConfig().strategy),
            DeclareLaunchArgument('image', default_value='rgb/image', description='colour topic'),
            DeclareLaunchArgument('depth', default_value='depth/image'),
            DeclareLaunchArgument('camera_info', default_value='rgb/camera_info'),
            DeclareLaunchArgument('use_sim_time', default_value='false'),
            Node(
                package='hoid_filter',
                executable='hoid_filter_node',
                name='hoid_filter',
                namespace=LaunchConfiguration('namespace'),
                output='screen',
                remappings=[
                    ('rgb/image', image),
                    ('rgb/image/compressed', [image, '/compressed']),
                    ('depth/image', depth),
                    ('depth/image/compressedDepth', [depth, '/compressedDepth']),
                    ('rgb/camera_info', LaunchConfiguration('camera_info')),
                ],
                parameters=[
                    ParameterFile(LaunchConfiguration('params_file'), allow_substs=True),
                    {
                        'strategy': ParameterValue(
                            LaunchConfiguration('strategy'), value_type=str
                        ),
                        'use_sim_time': ParameterValue(
                            LaunchConfiguration('use_sim_time'), value_type=bool
                        ),
                    },
                ],
            ),
        ]
    )
