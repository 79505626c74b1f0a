"""A floor of a building: the plan of its rooms and corridors, and the path of a robot in it."""
