"""Fault injection into running nodes: wrong messages, two hosts, bad conditions. Needs ROS."""
