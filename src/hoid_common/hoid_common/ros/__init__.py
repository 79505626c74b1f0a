"""ROS code that the nodes share: conversions, parameters, QoS, diagnostics, spinning."""
