"""Processes of their own: children that work for this one, starts and signals.

Nothing here knows ROS.
"""
