"""Tracks of people and objects in the map frame, from classified detections with depth."""
