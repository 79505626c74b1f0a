"""What two or more packages of the suite share: values, geometry, configuration and errors."""
