"""Playing bags on topics and recording topics into bags.

This is the only part of `hoid_bags` that needs ROS.
"""
