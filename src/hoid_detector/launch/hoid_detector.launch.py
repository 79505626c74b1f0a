"""The detector alone, also on another computer than the rest of the suite.

ros2 launch hoid_detector hoid_detector.launch.py image:=/camera/color/image_raw

How discovery is kept to one computer is said in hoid_bringup's hoid.launch.py.
"""

from __future__ import annotations

from hoid_common.ros.launch_files import Argument, one_node
from launch import LaunchDescription

ARGUMENT = Argument('model', default_value='', description='ONNX file or known name')


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the node."""
    return one_node('hoid_detector', {'model': 'model'}, [ARGUMENT])
