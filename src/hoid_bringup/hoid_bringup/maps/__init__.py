"""Commands for saved maps, without ROS."""
