"""Roles of a box in `classify_boxes`, as numbers; a box with neither role has the number 0."""

PERSON = 1
MAY_BE_HANDLED = 2  # an object of a class that people may handle
