"""Body models of people, and their gait.

Nothing here depends on a room.
"""
