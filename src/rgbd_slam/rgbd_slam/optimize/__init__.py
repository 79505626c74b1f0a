"""Least squares: pose, local bundle adjustment, pose graph, and how noisy the measurements are.

The only room that imports GTSAM; nothing here decides what to optimise.
"""
