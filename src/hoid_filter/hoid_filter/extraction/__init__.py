"""ORB features: image pyramid, FAST corners, their distribution over the image, descriptors."""
