"""Errors of trajectories with respect to ground truth, and their plots."""
