"""Trajectories against the truth, and their plots.

Nothing here runs SLAM.
"""
