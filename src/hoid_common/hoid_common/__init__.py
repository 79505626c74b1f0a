"""Code that several packages of the suite use: values, geometry, configuration, files, ROS."""
