"""The scene: dense map, grid, people and objects, from images with known poses.

Nothing in this package uses features. Only the folder `ros` and `node.py` depend on ROS.
"""
