"""The data model: frames, keyframes, map points, the atlas that holds them, and trajectories.

Matching, optimization and decisions do not belong here.
"""
