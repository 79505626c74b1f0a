"""Files and encodings: images, camera calibrations, parameter files, trajectories as text.

Nothing here imports ROS or depends on a processing stage.
"""
