"""Least squares: poses, bundle adjustment and pose graphs, and the noise of the measurements.

Only this package imports GTSAM. It does not decide what is optimized.
"""
