"""Nodes as supervised processes, and recordings that are replayed to them."""
