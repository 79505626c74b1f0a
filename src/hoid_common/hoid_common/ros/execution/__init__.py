"""Executors and threads that run callbacks.

Nothing here knows what they do.
"""
