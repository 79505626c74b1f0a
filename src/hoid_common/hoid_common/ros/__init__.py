"""The suite's seam to ROS: conversions, parameters, QoS, diagnostics, node entry point."""
