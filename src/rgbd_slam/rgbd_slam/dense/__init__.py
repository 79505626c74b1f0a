"""Dense map of the static room: coloured voxels, floor, navigation grid, export."""
