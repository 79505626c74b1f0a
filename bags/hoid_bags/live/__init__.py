"""Playing bags on topics and recording topics into bags.

Modules of this package import rclpy, which no other part of `hoid_bags` does.
"""
