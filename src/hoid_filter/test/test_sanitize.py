"""Validation of detections."""

import numpy as np
import pytest

from hoid_common.values import Detections
from hoid_filter.detections.sanitize import sanitize

from .helpers import detections


def test_good_detections_pass_untouched() -> None:
    good = detections(('person', (0.0, 0.0, 160.0, 120.0)))
    assert sanitize(good, 160, 120, 10) == (good, 0, 0)


def test_unusable_boxes_are_refused_and_counted() -> None:
    nan = float('nan')
    bad = detections(
        ('person', (nan, 0.0, 10.0, 10.0)),
        ('person', (20.0, 0.0, 10.0, 10.0)),  # inverted
        ('person', (200.0, 0.0, 210.0, 10.0)),  # outside
        ('person', (5.0, 5.0, 5.0, 10.0)),  # no area
        ('person', (0.0, 0.0, float('inf'), 10.0)),
        ('cup', (1.0, 2.0, 3.0, 4.0)),
    )
    fit, refused, clipped = sanitize(bad, 160, 120, 10)
    assert fit.class_names == ('cup',)
    assert (refused, clipped) == (5, 0)


@pytest.mark.parametrize(
    'wrong',
    [
        ('left', -0.1), ('right', 4.9), ('right', 160.1), ('top', -1.0), ('bottom', 6.0),
        ('bottom', 121.0), ('left', np.nan), ('top', np.nan), ('right', np.nan),
        ('score', -0.01), ('score', 1.01), ('score', np.nan),
    ],
)  # fmt: skip
def test_one_invalid_number_among_good_detections_is_noticed(wrong: tuple[str, float]) -> None:
    what, value = wrong
    given = detections(('cup', (1.0, 2.0, 3.0, 4.0)), ('person', (5.0, 6.0, 9.0, 9.0)))
    if what == 'score':
        given.scores[1] = value
    else:
        given.boxes_xyxy_px[1, ('left', 'top', 'right', 'bottom').index(what)] = value
    fit, refused, clipped = sanitize(given, 160, 120, 10)
    assert refused + clipped == 1
    assert len(fit) == 2 - refused


def test_boxes_beyond_the_image_and_scores_beyond_one_are_clipped() -> None:
    wide = detections(('person', (-5.0, 10.0, 500.0, 50.0)), score=1.5)
    fit, refused, clipped = sanitize(wide, 160, 120, 10)
    assert fit.boxes_xyxy_px.tolist() == [[0.0, 10.0, 160.0, 50.0]]
    assert fit.scores.tolist() == [1.0]
    assert (refused, clipped) == (0, 1)


def test_a_million_boxes_leave_the_best() -> None:
    num = 1_000_000
    scores = np.linspace(0, 1, num, dtype=np.float32)
    flood = Detections(
        0, np.tile(np.array([1, 1, 9, 9], np.float32), (num, 1)), ('cup',) * num, scores
    )
    fit, refused, _ = sanitize(flood, 160, 120, 300)
    assert len(fit) == 300
    assert fit.scores.min() > 0.99
    assert refused == num - 300
