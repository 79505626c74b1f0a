"""The scene process: the node that maps the scene, and the SLAM node's connection to it.

All topics and services of the scene belong to the SLAM node. The algorithms are in
`rgbd_slam.scene`.
"""
