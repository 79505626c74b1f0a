"""The SLAM node alone.

ros2 launch rgbd_slam rgbd_slam.launch.py base_frame:=base_link
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

from hoid_common.topics import NAMESPACED_TF
from launch import LaunchDescription

PARAMS = PathJoinSubstitution([FindPackageShare('rgbd_slam'), 'config', 'rgbd_slam.yaml'])


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the node."""
    image, depth = LaunchConfiguration('image'), LaunchConfiguration('depth')
    return LaunchDescription(
        [
            DeclareLaunchArgument('namespace', default_value=''),
            DeclareLaunchArgument('params_file', default_value=PARAMS),
            DeclareLaunchArgument('image', default_value='rgb/image', description='colour topic'),
            DeclareLaunchArgument('depth', default_value='depth/image', description='registered'),
            DeclareLaunchArgument('camera_info', default_value='rgb/camera_info'),
            DeclareLaunchArgument(
                'base_frame', default_value='', description="empty: the camera's own"
            ),
            DeclareLaunchArgument('use_sim_time', default_value='false'),
            Node(
                package='rgbd_slam',
                executable='rgbd_slam_node',
                name='rgbd_slam',
                namespace=LaunchConfiguration('namespace'),
                output='screen',
                remappings=[
                    ('rgb/image', image),
                    ('rgb/image/compressed', [image, '/compressed']),
                    ('depth/image', depth),
                    ('depth/image/compressedDepth', [depth, '/compressedDepth']),
                    ('rgb/camera_info', LaunchConfiguration('camera_info')),
                    *NAMESPACED_TF,
                ],
                parameters=[
                    ParameterFile(LaunchConfiguration('params_file'), allow_substs=True),
                    {
                        'frames.base': ParameterValue(
                            LaunchConfiguration('base_frame'), value_type=str
                        ),
                        'use_sim_time': ParameterValue(
                            LaunchConfiguration('use_sim_time'), value_type=bool
                        ),
                    },
                ],
            ),
        ]
    )
