"""What of the filter knows ROS beside its node: what it publishes.

No decision of the method belongs here.
"""
