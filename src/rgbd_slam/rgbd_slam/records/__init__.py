"""Structures of arrays, and arrays in temporary files; independent of SLAM."""
