"""Launches the SLAM node alone.

./hoid env ros2 launch rgbd_slam rgbd_slam.launch.py base_frame:=base_link

See hoid.launch.py of hoid_bringup for the limitation of discovery to one computer.
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
