"""Parameters of every stage as frozen dataclasses: the only place of their names and defaults.

Algorithms, and anything that depends on another package folder, do not belong here.
"""
