"""The rules that classify each image on its own, with known answers."""

from typing import Any

import numpy as np
import pytest

from hoid_common.values import Float32Array, ObjectState
from hoid_filter.config import FilterConfig
from hoid_filter.strategy import Verdict, make_strategy

from .helpers import HEIGHT, WIDTH, BoxTuple, detections, picture_of, view

S, P, H = ObjectState.AT_REST, ObjectState.PERSON, ObjectState.HANDLED
PERSON_BOX = (0.0, 0.0, 44.0, 120.0)


def classify(
    strategy: str,
    *rows: tuple[str, BoxTuple],
    depth_m: Float32Array | None = None,
    corners_xy_px: tuple[tuple[int, int], ...] | None = None,
    **values: Any,
) -> Verdict:
    config = FilterConfig(strategy=strategy, **values)
    return make_strategy(config).classify(view(detections(*rows), depth_m, corners_xy_px))


@pytest.mark.parametrize(
    ('strategy', 'reasons'),
    [('none', (S, S)), ('person', (P, S)), ('hoid2d', (P, H)), ('hoid3d', (P, H))],
)
def test_what_each_strategy_removes(strategy: str, reasons: tuple[ObjectState, ...]) -> None:
    verdict = classify(strategy, ('person', PERSON_BOX), ('cup', (30.0, 40.0, 50.0, 60.0)))
    assert verdict.objects.reasons == reasons


def test_interaction_area_must_be_greater_than_the_limit() -> None:
    at_limit = classify('hoid2d', ('person', PERSON_BOX), ('cup', (40.0, 40.0, 50.0, 60.0)))
    beyond = classify('hoid2d', ('person', PERSON_BOX), ('cup', (39.9, 40.0, 49.9, 60.0)))
    assert at_limit.objects.overlap_ratios[1] == 0.4
    assert at_limit.objects.reasons == (P, S)
    assert beyond.objects.reasons == (P, H)


def test_only_listed_classes_are_handled_and_an_empty_list_means_all() -> None:
    rows = (('person', PERSON_BOX), ('sink', (10.0, 40.0, 30.0, 60.0)))
    assert classify('hoid2d', *rows).objects.reasons == (P, S)
    assert classify('hoid2d', *rows, dynamic_classes=()).objects.reasons == (P, H)


@pytest.mark.parametrize(('cup_m', 'reason'), [(2.1, H), (2.3, S), (0.0, H)])
def test_3d_rule_wants_equal_depth(cup_m: float, reason: ObjectState) -> None:
    depth_m = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth_m[5:25, 30:50] = cup_m
    verdict = classify(
        'hoid3d', ('person', PERSON_BOX), ('cup', (30.0, 5.0, 50.0, 25.0)), depth_m=depth_m
    )
    assert verdict.objects.reasons[1] is reason
    if cup_m > 0:
        assert verdict.objects.depth_gaps_m[1] == pytest.approx(cup_m - 2.0, abs=1e-6)
    else:
        assert np.isnan(verdict.objects.depth_gaps_m[1])


def test_3d_rule_takes_the_person_at_the_objects_depth() -> None:
    depth_m = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth_m[:, 60:] = 4.0
    rows = (
        ('person', (0.0, 0.0, 60.0, 120.0)),  # covers all of the book, but stands before it
        ('person', (25.0, 0.0, 160.0, 120.0)),
        ('book', (20.0, 30.0, 60.0, 50.0)),
    )
    depth_m[30:50, 20:60] = 4.0
    depth_m[55:65, 20:60] = 2.0
    verdict = classify('hoid3d', *rows, depth_m=depth_m)
    assert verdict.objects.reasons[2] is H
    assert verdict.objects.depth_gaps_m[2] == 0.0


def test_descriptor_sees_a_person_within_the_window_of_a_key_point() -> None:
    rows = (('person', PERSON_BOX), ('cup', (48.0, 40.0, 70.0, 60.0)))  # key point at (50, 50)
    assert classify('descriptor', *rows, corners_xy_px=((50, 50),)).objects.reasons == (P, H)
    assert classify('descriptor', *rows, corners_xy_px=((68, 50),)).objects.reasons == (P, S)


def test_mask_covers_dynamic_boxes_to_the_pixel() -> None:
    verdict = classify(
        'hoid2d',
        ('person', (10.0, 20.0, 30.0, 40.0)),
        ('cup', (25.0, 30.0, 35.5, 40.0)),
        ('tv', (100.0, 10.0, 120.0, 20.0)),
    )
    expected = np.ones((HEIGHT, WIDTH), np.bool_)
    expected[20:40, 10:30] = False
    expected[30:40, 25:36] = False
    assert np.array_equal(picture_of(verdict.kept), expected)
    assert verdict.static_area_px == np.count_nonzero(expected)


def test_nothing_detected_keeps_everything() -> None:
    for strategy in ('none', 'person', 'hoid2d', 'hoid3d', 'descriptor'):
        verdict = classify(strategy)
        assert verdict.kept is None
        assert verdict.static_area_px == HEIGHT * WIDTH
        assert verdict.objects.reasons == ()
