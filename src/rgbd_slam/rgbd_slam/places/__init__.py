"""Recognises a place that was seen before and proves it by geometry.

What follows from it (relocalisation, loops) is for the rooms above.
"""
