"""Bags of rosbag2: reading, writing, and the topics of an RGB-D recording in them.

This package does not need ROS, except for `bag_types.message_class`.
"""
