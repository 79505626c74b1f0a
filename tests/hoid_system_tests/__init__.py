"""Topic-level, replay and fault tests of the HOID suite."""
