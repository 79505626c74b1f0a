"""Motion segmentation without a detector: regions of the depth image that move in the world.

Nothing here knows object classes. The low-resolution images are those of a pinhole camera without
lens distortion.
"""
