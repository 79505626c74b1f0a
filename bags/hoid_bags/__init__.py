"""TUM folders and rendered scenes to MCAP bags; info, play and record."""
