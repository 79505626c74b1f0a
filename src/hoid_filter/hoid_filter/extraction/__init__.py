"""ORB features: image pyramid, FAST corners, their distribution over the image, descriptors.

Nothing here knows about objects.
"""
