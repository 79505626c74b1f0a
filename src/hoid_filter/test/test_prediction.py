"""Prediction of boxes from the last two detections."""

import numpy as np

from hoid_filter.detections.prediction import BoxPredictor

from .helpers import detections


def test_motion_is_extended_to_the_stamp() -> None:
    predictor = BoxPredictor(limit_s=0.5)
    predictor.observe(detections(('person', (10.0, 10.0, 50.0, 90.0)), stamp_ns=0))
    moved = detections(
        ('cup', (0.0, 0.0, 5.0, 5.0)), ('person', (14.0, 10.0, 54.0, 90.0)), stamp_ns=100_000_000
    )
    predictor.observe(moved)
    predicted = predictor.predict(150_000_000)
    assert predicted.stamp_ns == 150_000_000
    assert predicted.class_names == ('cup', 'person')
    assert np.allclose(predicted.boxes_xyxy_px, [[0, 0, 5, 5], [16, 10, 56, 90]])


def test_old_boxes_are_forgotten() -> None:
    predictor = BoxPredictor(limit_s=0.5)
    predictor.observe(detections(('person', (10.0, 10.0, 50.0, 90.0)), stamp_ns=0))
    assert len(predictor.predict(500_000_000)) == 1
    assert len(predictor.predict(500_000_001)) == 0


def test_nothing_seen_nothing_predicted() -> None:
    assert len(BoxPredictor(1.0).predict(5)) == 0
