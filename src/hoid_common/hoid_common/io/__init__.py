"""Files and encoded data: images, cameras, parameters, trajectories as text, records.

Nothing here knows ROS or a stage.
"""
