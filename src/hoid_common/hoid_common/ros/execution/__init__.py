"""Executors and threads that run the callbacks of nodes, independent of what the callbacks do."""
