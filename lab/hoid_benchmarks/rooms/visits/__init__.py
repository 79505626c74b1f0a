"""Second visits: what an object map says of a room that was rearranged while nobody watched."""
