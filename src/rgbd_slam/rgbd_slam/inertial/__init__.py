"""The IMU: samples, calibration by the tracked motion, gravity, and detection of faults."""
