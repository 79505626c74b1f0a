"""The dense map, the navigation grid, and people and objects as tracks.

Nothing here knows features, or imports ROS.
"""
