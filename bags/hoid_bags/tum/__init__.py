"""Folders in the TUM RGB-D layout and their cameras.

This package does not depend on bags.
"""
