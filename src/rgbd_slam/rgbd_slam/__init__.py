"""RGB-D SLAM on ORB features: tracking, mapping, and the map they share.

Knows no ROS outside `node.py`.
"""
