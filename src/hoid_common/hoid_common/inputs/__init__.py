"""Inputs of a node, in code without ROS: parameters, missing messages, registration of depth."""
