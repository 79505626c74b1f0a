"""Cases of running nodes: wrong messages, two hosts, bad conditions. All of it needs ROS."""
