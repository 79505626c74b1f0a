"""Playing bags on topics and recording topics into bags.

The only room of the package that runs a ROS node.
"""
