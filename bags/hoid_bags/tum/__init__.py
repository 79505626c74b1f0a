"""Folders in the TUM RGB-D layout and their cameras.

This folder does not depend on bags.
"""
