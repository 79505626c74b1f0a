"""The object map: where each object of the scene is at rest, and who moved it.

Nothing in this folder uses features or imports ROS.
"""
