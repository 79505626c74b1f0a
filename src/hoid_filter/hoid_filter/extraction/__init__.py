"""ORB features: image pyramid, FAST corners, their distribution over the image, descriptors.

This package does not depend on detections or strategies.
"""
