"""Pose estimation of single frames, and the decision which frames become keyframes.

The modules of this package do not change the map.
"""
