"""What several packages of the suite share: values, geometry, configuration, files, ROS."""
