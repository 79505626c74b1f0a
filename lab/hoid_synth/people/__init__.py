"""Body models of people, and their gait.

This package does not depend on the room.
"""
