"""Matching of features with map points: search windows, local maps and Hamming distances.

The modules of this package change neither poses nor the map.
"""
