"""Parameters of every stage as frozen dataclasses: the only place of their defaults."""
