"""The plan: experiments, sequences, and perturbations of sequences and detections.

This package does not run jobs or draw figures.
"""
