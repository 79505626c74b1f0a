"""Sensors of motion beside the camera: wheel odometry and an IMU."""
