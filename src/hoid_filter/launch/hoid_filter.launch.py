"""Launches only the filter node.

./hoid env ros2 launch hoid_filter hoid_filter.launch.py strategy:=hoid2d image:=/color/image_raw

hoid.launch.py of hoid_bringup explains how discovery is limited to one computer.
"""

from __future__ import annotations

from hoid_common.ros.launch_files import Argument, one_node
from hoid_filter.config import FilterConfig
from hoid_filter.strategy_registry import STRATEGIES
from launch import LaunchDescription

ARGUMENT = Argument(
    'strategy',
    default_value=FilterConfig().strategy,
    description='how dynamic objects are identified',
    choices=list(STRATEGIES),
)


def generate_launch_description() -> LaunchDescription:
    return one_node('hoid_filter', {'strategy': 'strategy'}, [ARGUMENT])
