"""Matching of detections with true objects."""

import numpy as np
import pytest

from hoid_common.values import Detections
from hoid_training.evaluate import Count, Tally, Truth, count

TRUTH = Truth(
    ('person', 'cup', 'cup', 'book'),
    np.array([[0, 0, 40, 80], [50, 0, 70, 20], [80, 0, 120, 40], [0, 90, 10, 100]], np.float32),
    np.array([3000.0, 400.0, 1500.0, 60.0]),
)
FOUND = Detections(
    0,
    np.array(
        [
            [0, 0, 40, 60],  # the person: overlap 0.75
            [0, 0, 40, 80],  # the same person again
            [50, 0, 70, 9],  # the first cup: overlap 0.45
            [80, 0, 120, 40],  # the second cup
            [50, 0, 70, 20],  # the first cup, of another class
            [0, 90, 10, 100],  # the book that is not asked for
        ],
        np.float32,
    ),
    ('person', 'person', 'cup', 'cup', 'bottle', 'book'),
    np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.4], np.float32),
)


def test_each_object_is_found_once_and_by_its_own_class() -> None:
    tally = Tally()
    count(tally, TRUTH, FOUND)
    assert tally.people() == Count(asked=1, found=1, large=1, large_found=1, reported=2, right=1)
    assert tally.objects() == Count(asked=2, found=1, large=1, large_found=1, reported=4, right=2)
    assert tally.of('book') == Count(reported=1, right=1)
    assert tally.objects().recall == 0.5
    assert tally.objects().large_recall == 1.0
    assert tally.people().precision == 0.5


@pytest.mark.parametrize(('min_score', 'reported'), [(0.0, 6), (0.6, 4), (0.95, 0)])
def test_weak_detections_can_be_left_out(min_score: float, reported: int) -> None:
    tally = Tally()
    count(tally, TRUTH, FOUND, min_score)
    assert (tally.people() + tally.objects()).reported == reported


def test_nothing_found_and_nothing_there() -> None:
    tally = Tally()
    empty = Truth((), np.empty((0, 4), np.float32), np.empty(0))
    count(tally, empty, Detections.none(0))
    assert (tally.people().recall, tally.objects().precision) == (0.0, 0.0)
    count(tally, TRUTH, Detections.none(0))
    assert tally.objects() == Count(asked=2, large=1)
    count(tally, empty, FOUND)
    assert tally.objects() == Count(asked=2, large=1, reported=4)
