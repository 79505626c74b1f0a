"""The HOID filter (human-object interaction detection) of image features.

It extracts features, and leaves out those on people, on the objects that they handle, and on other
moving regions.
"""
