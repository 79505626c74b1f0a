"""Rooms, furniture, props and their surfaces.

Nothing here moves.
"""
