"""Disks that are full, read-only or slow while the nodes write files."""
