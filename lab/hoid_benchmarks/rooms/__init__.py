"""Evaluation of dense map, occupancy grid and object tracks in rendered rooms.

Trajectories are evaluated by `hoid_benchmarks.jobs`.
"""
