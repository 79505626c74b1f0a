"""What the node needs of ROS beside itself: outputs and services."""
