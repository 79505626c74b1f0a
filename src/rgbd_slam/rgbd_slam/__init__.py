"""RGB-D SLAM on ORB features: tracking, mapping, and the map they share.

Knows no ROS outside `node.py` and `ros`.
"""

CHILD_MODULES = ('rgbd_slam.processes.mapper_worker', 'rgbd_slam.ros.scene.node')
"""What the node's processes begin with; see `hoid_common.process.entry`."""
