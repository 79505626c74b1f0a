"""Drawing of detections."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Detections
from hoid_detector.drawing import draw_detections


def test_boxes_are_drawn_on_a_copy_and_people_are_red() -> None:
    image = np.zeros((100, 200, 3), np.uint8)
    boxes = np.array([[10, 20, 60, 90], [100, 0, 200, 100]], np.float32)
    scores = np.array([0.9, 0.5], np.float32)
    picture = draw_detections(image, Detections(0, boxes, ('person', 'cup'), scores))
    assert not image.any()
    assert picture[60, 10].argmax() == 2  # left edge of the person: red
    assert picture[60, 100].argmax() == 1  # of the cup: green
    assert not picture[50:80, 65:95].any()
    assert not picture[40:80, 20:50].any()


def test_without_detections_the_picture_is_unchanged() -> None:
    image = np.full((10, 10, 3), 7, np.uint8)
    np.testing.assert_array_equal(draw_detections(image, Detections.none(0)), image)
