"""The HOID filter (human-object interaction detection) of image features."""
