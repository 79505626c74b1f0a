"""Recordings: reading of TUM folders and bags, conversion, summary, playback and recording."""
