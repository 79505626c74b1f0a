"""Search of the object map: by class, color, room, place relative to other things, and time."""
