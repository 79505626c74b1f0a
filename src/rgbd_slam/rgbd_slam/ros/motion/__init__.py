"""Sensors that measure motion besides the camera: wheel odometry and an IMU."""
