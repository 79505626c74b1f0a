"""Motion segmentation without a detector: finds regions of the image that move in the world."""
