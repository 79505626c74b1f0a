"""Offline runs without ROS: all stages on every frame of a recording, and output files."""
