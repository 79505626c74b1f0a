"""Inputs of a node, without ROS: parameters of subscriptions, missing messages, registration."""
