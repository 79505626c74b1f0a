"""Loop closing and map merging: detection, pose graph optimization, global bundle adjustment.

No module of this package uses single images.
"""
