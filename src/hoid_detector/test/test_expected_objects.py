"""Weak boxes are reported only where the object map expects an object of their class."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hoid_common.values import Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.expected_objects import confirmed_rows
from hoid_detector.onnx_detector import OnnxDetector

IMAGE = np.full((128, 192, 3), 60, np.uint8)
NONE = Detections.none(0)
PRIOR = DetectorConfig(expected_score_threshold=0.05)
CUP = (100.0, 16.0, 180.0, 48.0)  # twice the second row, which is in the 96 x 64 input
ROWS = (
    (10.0, 20.0, 30.0, 60.0, 0.9, 0.0),
    (50.0, 8.0, 90.0, 24.0, 0.1, 41.0),  # a cup below the threshold
    (52.0, 8.0, 92.0, 24.0, 0.2, 45.0),  # a bowl at the same place, also below it
    (60.0, 30.0, 80.0, 60.0, 0.1, 41.0),  # a cup where none is expected
)


def boxes(*rows: tuple[str, float, tuple[float, ...]], stamp_ns: int = 0) -> Detections:
    return Detections(
        stamp_ns,
        np.array([row[2] for row in rows], np.float32).reshape(-1, 4),
        tuple(row[0] for row in rows),
        np.array([row[1] for row in rows], np.float32),
    )


def test_the_best_weak_box_of_the_expected_class_is_confirmed() -> None:
    weak = boxes(
        ('cup', 0.1, (2.0, 0.0, 12.0, 10.0)),
        ('cup', 0.2, (1.0, 0.0, 11.0, 10.0)),
        ('bowl', 0.2, (0.0, 0.0, 10.0, 10.0)),
        ('cup', 0.2, (6.0, 0.0, 16.0, 10.0)),  # overlaps by a quarter only
    )
    expected = boxes(('cup', 0.9, (0.0, 0.0, 10.0, 10.0)))
    assert confirmed_rows(weak, NONE, expected).tolist() == [1]


def test_an_expected_object_that_was_detected_confirms_nothing() -> None:
    weak = boxes(('cup', 0.1, (2.0, 0.0, 12.0, 10.0)))
    expected = boxes(('cup', 0.9, (0.0, 0.0, 10.0, 10.0)))
    strong = boxes(('bowl', 0.9, (1.0, 0.0, 11.0, 10.0)))
    assert confirmed_rows(weak, strong, expected).tolist() == []


def test_expected_boxes_are_shifted_with_those_that_were_detected() -> None:
    weak = boxes(('cup', 0.1, (60.0, 5.0, 70.0, 15.0)))
    table, moved = (20.0, 0.0, 60.0, 20.0), (30.0, 5.0, 70.0, 25.0)
    expected = boxes(('table', 0.9, table), ('cup', 0.9, (50.0, 0.0, 60.0, 10.0)))
    assert confirmed_rows(weak, NONE, expected).tolist() == []
    assert confirmed_rows(weak, boxes(('table', 0.9, moved)), expected).tolist() == [0]


def test_where_objects_were_expected_long_ago_has_no_effect() -> None:
    weak = boxes(('cup', 0.1, (0.0, 0.0, 10.0, 10.0)), stamp_ns=2_000_000_000)
    old = boxes(('cup', 0.9, (0.0, 0.0, 10.0, 10.0)))
    assert confirmed_rows(weak, NONE, old).tolist() == []


@pytest.mark.parametrize(
    ('config', 'names'),
    [
        (PRIOR, ('person', 'cup')),
        (DetectorConfig(), ('person',)),
        (DetectorConfig(expected_score_threshold=0.15), ('person',)),
        (DetectorConfig(expected_score_threshold=0.05, classes=('person',)), ('person',)),
    ],
)
def test_the_detector_reports_a_weak_box_where_it_is_expected(
    config: DetectorConfig, names: tuple[str, ...], make_model: Any
) -> None:
    model = make_model({'output0': np.array(ROWS, np.float32)[None]})
    detector = OnnxDetector(model, config)
    assert detector.detect(IMAGE, 0).class_names == ('person',)
    detector.expected = boxes(('cup', 0.8, CUP))
    found = detector.detect(IMAGE, 0)
    assert found.class_names == names
    if 'cup' in names:
        np.testing.assert_array_equal(found.boxes_xyxy_px[1], CUP)
        assert found.scores.tolist() == pytest.approx([0.9, 0.1])


def test_expected_boxes_are_those_of_the_image_that_is_not_turned(make_model: Any) -> None:
    model = make_model({'output0': np.array(ROWS, np.float32)[None]})
    turned = DetectorConfig(expected_score_threshold=0.05, camera_roll_deg=180.0)
    detector = OnnxDetector(model, turned)
    detector.expected = boxes(('cup', 0.8, CUP))
    assert detector.detect(IMAGE, 0).class_names == ('person',)
    detector.expected = boxes(('cup', 0.8, (12.0, 80.0, 92.0, 112.0)))
    assert detector.detect(IMAGE, 0).class_names == ('person', 'cup')
