"""The filter alone.

ros2 launch hoid_filter hoid_filter.launch.py strategy:=hoid2d image:=/camera/color/image_raw

How discovery is kept to one computer is said in hoid_bringup's hoid.launch.py.
"""

from __future__ import annotations

from hoid_common.ros.launch_files import Argument, one_node
from hoid_filter.config import STRATEGIES, FilterConfig
from launch import LaunchDescription

ARGUMENT = Argument(
    'strategy',
    default_value=FilterConfig().strategy,
    description='how dynamic objects are told',
    choices=list(STRATEGIES),
)


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments and the node."""
    return one_node('hoid_filter', {'strategy': 'strategy'}, [ARGUMENT])
