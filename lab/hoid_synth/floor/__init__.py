"""The plan of a floor with many rooms, and the drive of a robot through it."""
