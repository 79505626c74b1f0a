"""Pose estimation of single frames, and the decision which frames become keyframes.

No module of this package changes the map.
"""
