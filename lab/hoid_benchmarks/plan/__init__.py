"""What is measured on what: experiments, sequences, and how they are perturbed.

Nothing here runs or draws.
"""
