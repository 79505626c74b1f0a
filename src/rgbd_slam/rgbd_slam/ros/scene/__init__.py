"""The scene process: the node that maps the scene, and the SLAM node's connection to it.

The SLAM node publishes all topics of the scene, and offers its services. The algorithms are in
`hoid_scene`.
"""
