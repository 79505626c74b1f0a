"""Detected boxes over time: checks, tracks, and prediction to the stamp of an image.

Nothing here decides which objects are dynamic.
"""
