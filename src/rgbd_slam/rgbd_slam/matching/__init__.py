"""Which feature shows which map point: search windows, local maps and Hamming distances.

Nothing here moves a pose or changes the map.
"""
