"""From the features of one image to its pose, and when that image should become a keyframe.

Nothing here writes to the map.
"""
