"""Rooms, furniture and movable objects at their first place.

Motions are planned in `acting`.
"""
