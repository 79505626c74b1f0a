"""Bodies and how they walk.

Nothing here knows a room.
"""
