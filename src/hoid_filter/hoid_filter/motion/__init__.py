"""Motion segmentation without a detector: regions of the depth image that move in the world."""
