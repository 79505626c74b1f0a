"""Parameters of every stage as frozen dataclasses, the one place of names and defaults.

No algorithm, and nothing of another room, belongs here.
"""
