"""HOID (human-object interaction detection): removes the features on moving people and objects."""
