"""Executors and threads that run the callbacks of nodes.

Nothing here depends on what the callbacks do.
"""
