"""Scenarios that are one long drive: corridors of several floors, a large map, rendered rooms."""
