"""Where the mapper runs: in the tracker's process or in one of its own.

Steps of mapping do not belong here; see `rgbd_slam.mapper`.
"""
