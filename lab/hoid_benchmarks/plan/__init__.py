"""The plan: experiments, sequences, and perturbations of sequences and detections.

Nothing here runs jobs or draws figures.
"""
