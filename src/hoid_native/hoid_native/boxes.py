"""Numbers of the roles of boxes in `classify_boxes`; 0 is that of a box with neither role."""

PERSON = 1
MAY_BE_HANDLED = 2  # an object of a class that people may handle
