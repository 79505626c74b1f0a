"""Commands that read saved maps, without ROS."""
