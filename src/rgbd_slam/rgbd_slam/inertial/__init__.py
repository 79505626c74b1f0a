"""An IMU: samples, calibration against the tracked motion, gravity and faults."""
