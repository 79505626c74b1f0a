"""Poses over time: of frames on the robot, of the camera, and of the keyframes of a map."""
