"""Decoding of compressed images in the formats of image_transport's plugins."""
