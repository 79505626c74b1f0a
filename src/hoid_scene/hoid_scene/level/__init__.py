"""The vertical: which direction is up, and boxes that stand upright."""
