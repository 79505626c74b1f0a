"""An IMU: samples, calibration against the tracked motion, gravity and faults.

This package knows neither images nor maps.
"""
