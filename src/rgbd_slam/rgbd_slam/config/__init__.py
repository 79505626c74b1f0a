"""Parameters of every stage as frozen dataclasses; defaults are set only here."""
