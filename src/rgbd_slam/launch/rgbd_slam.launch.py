"""The SLAM node alone.

./hoid env ros2 launch rgbd_slam rgbd_slam.launch.py base_frame:=base_link

hoid_bringup's hoid.launch.py explains how discovery is kept to one computer.
"""

from __future__ import annotations

from hoid_common.ros.launch_files import Argument, one_node
from launch import LaunchDescription

ARGUMENT = Argument(
    'base_frame', default_value='', description="the robot's; empty: the camera's own"
)


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the node."""
    return one_node('rgbd_slam', {'frames.base': 'base_frame'}, [ARGUMENT])
