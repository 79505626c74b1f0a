"""Place recognition: finds keyframes that show the place of an image, and verifies its pose."""
