"""Carries the plan out, run by run, and keeps the results.

Nothing here draws.
"""
