"""Boxes of the detector: validation, tracking, and prediction to the stamp of an image."""
