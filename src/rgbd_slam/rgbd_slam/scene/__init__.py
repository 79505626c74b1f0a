"""The scene: dense map, navigation grid, and people and objects as tracks.

Nothing in this folder uses features or imports ROS.
"""
