"""Roles of boxes in `classify_boxes`; 0 = neither a person nor an object that is handled."""

PERSON = 1
MAY_BE_HANDLED = 2  # an object of a class that people may handle
