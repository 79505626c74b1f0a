"""Least-squares optimization of poses, bundles and pose graphs, and the measurement noise.

No other package imports GTSAM. What is optimized is decided elsewhere.
"""
