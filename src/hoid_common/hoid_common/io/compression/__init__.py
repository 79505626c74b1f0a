"""Compressed images, as the plugins of image_transport publish them."""
