"""Processes of their own: children that work for this one, starts, signals, shared memory.

Nothing here imports ROS.
"""
