"""Pictures and the 3-D viewer of recordings and runs.

Nothing here computes a result.
"""
