"""RGB-D SLAM on ORB features: tracking, mapping, and the map they share.

Only `node.py` and the folder `ros` depend on ROS.
"""

CHILD_MODULES = ('rgbd_slam.mapping.mapper_worker',)
"""Modules that are imported in advance for child processes; see `hoid_common.process.entry`."""
