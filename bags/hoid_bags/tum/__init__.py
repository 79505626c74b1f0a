"""Folders in the TUM RGB-D layout and their cameras.

Nothing here knows bags.
"""
