"""Roles of boxes in `classify_boxes`. A box with neither role has the number 0."""

PERSON = 1
MAY_BE_HANDLED = 2  # an object of a class that people may handle
