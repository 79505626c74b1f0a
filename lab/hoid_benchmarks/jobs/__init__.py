"""Runs the jobs of a plan and stores their results.

This package does not write tables of experiments or draw figures.
"""
