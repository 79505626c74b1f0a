"""Structures of arrays, and arrays in temporary files; nothing here knows what they mean."""
