"""Detected boxes over time: validation, tracking, and prediction to the stamp of an image."""
