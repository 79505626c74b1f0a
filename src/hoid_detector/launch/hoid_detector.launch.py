"""The detector alone, also on another computer than the rest of the suite.

ros2 launch hoid_detector hoid_detector.launch.py image:=/camera/color/image_raw
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PARAMS = PathJoinSubstitution([FindPackageShare('hoid_detector'), 'config', 'hoid_detector.yaml'])


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the node."""
    image = LaunchConfiguration('image')
    return LaunchDescription(
        [
            DeclareLaunchArgument('namespace', default_value=''),
            DeclareLaunchArgument('params_file', default_value=PARAMS),
            DeclareLaunchArgument(
                'model', default_value='', description='ONNX file or known name'
            ),
            DeclareLaunchArgument('image', default_value='rgb/image', description='colour topic'),
            DeclareLaunchArgument('use_sim_time', default_value='false'),
            DeclareLaunchArgument(
                'autostart', default_value='true', description='false: for a lifecycle manager'
            ),
            LifecycleNode(
                package='hoid_detector',
                executable='hoid_detector_node',
                name='hoid_detector',
                namespace=LaunchConfiguration('namespace'),
                output='screen',
                remappings=[
                    ('rgb/image', image),
                    ('rgb/image/compressed', [image, '/compressed']),
                ],
                parameters=[
                    ParameterFile(LaunchConfiguration('params_file'), allow_substs=True),
                    {
                        'model': ParameterValue(LaunchConfiguration('model'), value_type=str),
                        'autostart': ParameterValue(
                            LaunchConfiguration('autostart'), value_type=bool
                        ),
                        'use_sim_time': ParameterValue(
                            LaunchConfiguration('use_sim_time'), value_type=bool
                        ),
                    },
                ],
            ),
        ]
    )
