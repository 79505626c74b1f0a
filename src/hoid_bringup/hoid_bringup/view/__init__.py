"""The 3-D viewer of recordings, runs and saved maps."""
