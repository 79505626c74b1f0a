"""Launches only the scene node, beside a running rgbd_slam.

./hoid env ros2 launch hoid_scene hoid_scene.launch.py

hoid_bringup's hoid.launch.py explains how discovery is kept to one computer.
"""

from __future__ import annotations

from hoid_common.ros.launch_files import one_node
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    return one_node('hoid_scene', {}, [])
