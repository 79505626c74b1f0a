"""Roles of boxes, as `judge_boxes` takes and returns them."""

PERSON, MAY_BE_HANDLED = 1, 2
