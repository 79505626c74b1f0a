"""Matching of features with map points: search windows, local maps and Hamming distances.

No module of this package changes a pose or the map.
"""
