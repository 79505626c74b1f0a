"""Detected boxes over time: validation, tracking, and prediction to the stamp of an image.

This package does not decide which objects are dynamic.
"""
