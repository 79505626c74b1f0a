"""Boxes over time: which belong to an image, tracks, prediction across misses.

Nothing here decides what is dynamic.
"""
