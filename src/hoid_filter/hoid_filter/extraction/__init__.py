"""ORB features: pyramid, corners, spread, descriptors.

Nothing here knows boxes.
"""
