"""Motion segmentation without a detector: regions of the depth image that move in the world.

This package does not use object classes. Its downscaled depth images are those of a pinhole camera
without lens distortion.
"""
