"""Playing bags on topics and recording topics into bags.

The only folder of this package that needs ROS.
"""
