"""Errors of trajectories compared with ground truth, and plots of them."""
