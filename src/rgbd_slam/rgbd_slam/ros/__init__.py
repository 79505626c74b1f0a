"""The ROS part of the SLAM node: outputs, services, checkpoints and the life of the session."""
