"""Dense map, grid and tracks of rendered rooms, against the truth.

Nothing here concerns trajectories.
"""
