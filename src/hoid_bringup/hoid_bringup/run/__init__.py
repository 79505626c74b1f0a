"""Offline runs: all stages on every frame of a recording, and the output files. No ROS here."""
