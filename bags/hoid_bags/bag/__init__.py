"""rosbag2 MCAP bags: reading, writing, what their topics mean.

No ROS and no running node is needed.
"""
