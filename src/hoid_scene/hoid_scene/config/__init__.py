"""Parameters of the dense map, the tracks, the object map and the masks."""
