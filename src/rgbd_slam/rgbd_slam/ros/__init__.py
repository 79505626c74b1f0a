"""The ROS side of the SLAM node: outputs, services, checkpoints and the session's life cycle."""
