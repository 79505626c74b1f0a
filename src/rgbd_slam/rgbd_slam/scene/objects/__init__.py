"""The object map: where each thing of the scene is at rest, and who moved it.

Nothing in this folder uses features or imports ROS.
"""
