"""Inputs of a node: the parameters of its subscriptions, and the detection of missing messages.

Nothing here imports ROS.
"""
