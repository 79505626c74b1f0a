"""The room's maps beside the tracker: the process that makes them, and both ends of its pipes.

All that is published and served of them is on the SLAM node; no step of mapping belongs here.
"""
