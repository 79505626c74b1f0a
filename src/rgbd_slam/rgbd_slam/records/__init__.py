"""Structures of arrays, and arrays in temporary files; they know nothing of SLAM."""
