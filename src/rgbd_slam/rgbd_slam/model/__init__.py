"""The data model: frames, keyframes, map points, the atlas that holds them, and trajectories.

It contains no matching, no optimization and no decisions.
"""
