"""Runs the mapper in the tracker's process or in a separate process.

Steps of mapping do not belong here; see `rgbd_slam.mapper`.
"""
