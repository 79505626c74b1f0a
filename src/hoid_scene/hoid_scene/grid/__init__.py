"""The floor, the free space above it, and the occupancy grid of both."""
