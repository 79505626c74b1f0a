"""Launches the detector alone, for example on another computer than the rest of the suite.

./hoid env ros2 launch hoid_detector hoid_detector.launch.py image:=/camera/color/image_raw

See hoid.launch.py of hoid_bringup for discovery and transport settings.
"""

from __future__ import annotations

from hoid_common.ros.launch_files import Argument, one_node
from launch import LaunchDescription

ARGUMENTS = [
    Argument(
        'model', default_value='', description='ONNX model of the detector, a file or a known name'
    ),
    Argument(
        'base_frame',
        default_value='',
        description='base frame of the robot, which tells how the camera is rolled; empty: level',
    ),
]


def generate_launch_description() -> LaunchDescription:
    return one_node('hoid_detector', {'model': 'model', 'base_frame': 'base_frame'}, ARGUMENTS)
