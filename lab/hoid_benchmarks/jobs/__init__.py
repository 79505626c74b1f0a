"""Runs the jobs of a plan and stores their results.

Nothing here writes tables of experiments or draws figures.
"""
