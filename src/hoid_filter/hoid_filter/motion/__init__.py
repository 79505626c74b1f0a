"""What moves, told without a detector: regions of the depth image that do not rest in the world.

Nothing here knows a class. Positions in small images are of an ideal camera without distortion.
"""
