"""Offline runs: every frame of a recording through all stages, and the files that they leave.

No ROS.
"""
