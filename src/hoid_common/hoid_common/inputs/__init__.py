"""What is heard: how inputs are listened to, when they fall silent, which camera is believed.

Nothing here knows ROS.
"""
