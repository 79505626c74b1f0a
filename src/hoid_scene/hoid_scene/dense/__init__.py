"""The dense map: images with depth, fused into the voxels of submaps.

Nothing in this folder uses features or imports ROS.
"""
