"""Association of detections with tracks, and prediction of missed tracks."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.values import Detections
from hoid_filter.config import FilterConfig
from hoid_filter.detections.tracks import BoxTracker

from .helpers import BoxTuple, detections

FRAME_NS = 33_333_333
CHAIR: BoxTuple = (60.0, 60.0, 100.0, 110.0)


def tracker() -> BoxTracker:
    return BoxTracker(FilterConfig())


def observe(boxes: BoxTracker, found: Detections) -> None:
    boxes.observe(found, np.zeros(len(found), np.bool_))


def ids(boxes: BoxTracker, stamp_ns: int) -> dict[str, int]:
    tracks, _ = boxes.advance(stamp_ns, 640, 480)
    return {track.class_name: track.track_id for track in tracks if track.seen_ns == stamp_ns}


@pytest.mark.parametrize(
    ('name', 'box', 'is_same'),
    [
        ('chair', (70.0, 60.0, 115.0, 115.0), True),  # IoU 0.49: the same class
        ('couch', (60.0, 60.0, 103.0, 113.0), True),  # 0.88: the detector wavers
        ('dining table', (40.0, 50.0, 115.0, 115.0), False),  # 0.41: what the chair stands at
        ('person', CHAIR, False),
    ],
)
def test_another_class_needs_nearly_the_same_box(name: str, box: BoxTuple, is_same: bool) -> None:
    boxes = tracker()
    observe(boxes, detections(('chair', CHAIR)))
    known = ids(boxes, 0)['chair']
    observe(boxes, detections((name, box), stamp_ns=FRAME_NS))
    assert (ids(boxes, FRAME_NS)[name] == known) is is_same


def test_a_missed_box_moves_on_but_does_not_grow() -> None:
    boxes = tracker()
    for n in range(30):  # it comes nearer and goes to the right
        box = (100.0 + 4 * n, 100.0 - n, 140.0 + 6 * n, 200.0 + n)
        observe(boxes, detections(('person', box), stamp_ns=n * FRAME_NS))
    stamp_ns = 35 * FRAME_NS
    observe(boxes, Detections.none(stamp_ns))
    _, (missed,) = boxes.advance(stamp_ns, 640, 480)
    width, height = missed[2] - missed[0], missed[3] - missed[1]
    assert (width, height) == pytest.approx((98.0, 158.0))
    middle = (missed[0] + missed[2]) / 2, (missed[1] + missed[3]) / 2
    assert middle == pytest.approx((265.0 + 6 * 5, 150.0), abs=0.5)


def test_a_track_of_unsure_detections_ends_when_it_is_missed() -> None:
    boxes, doubt = tracker(), np.ones(1, np.bool_)
    for n in range(6):
        boxes.observe(detections(('person', CHAIR), stamp_ns=n * FRAME_NS), doubt)
    (track,), _ = boxes.advance(5 * FRAME_NS, 640, 480)
    assert track.is_confirmed  # confirmed after four detections in a row
    observe(boxes, Detections.none(6 * FRAME_NS))
    assert boxes.advance(6 * FRAME_NS, 640, 480)[0] == ()


def test_a_track_with_a_sure_detection_is_predicted_when_it_is_missed() -> None:
    boxes = tracker()
    for n in range(6):
        doubt = np.array([n != 3])
        boxes.observe(detections(('person', CHAIR), stamp_ns=n * FRAME_NS), doubt)
    observe(boxes, Detections.none(6 * FRAME_NS))
    assert len(boxes.advance(6 * FRAME_NS, 640, 480)[0]) == 1
