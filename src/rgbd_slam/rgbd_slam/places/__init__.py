"""Place recognition: finds keyframes that show the place of an image, and verifies the pose.

Relocalization and loop closing use it; it changes neither a pose nor the map.
"""
