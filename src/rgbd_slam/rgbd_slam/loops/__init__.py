"""Closes loops and merges maps: detection, pose graph, global bundle adjustment.

Nothing here sees single images.
"""
