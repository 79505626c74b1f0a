"""The object map: the place at rest of each object of the scene, and who moved it.

Nothing in this folder uses features or imports ROS.
"""
