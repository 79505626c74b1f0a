"""Overlap ratios and IoU of boxes, by properties."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hoid_filter.detections.sanitize import areas_px2, clip_boxes
from hoid_native import intersections_over_union, overlap_ratios

Box = NDArray[np.float64]


@st.composite
def boxes(draw: st.DrawFn) -> Box:
    """Return a (1, 4) box with an area, on a grid so that boxes touch."""
    x1, y1 = draw(st.integers(0, 2000)) / 4, draw(st.integers(0, 2000)) / 4
    width, height = draw(st.integers(1, 2000)) / 4, draw(st.integers(1, 2000)) / 4
    return np.array([[x1, y1, x1 + width, y1 + height]])


def box(*xyxy: float) -> Box:
    return np.array([xyxy], np.float64)


def test_known_ratios() -> None:
    thing = box(10, 10, 20, 30)
    people = np.array([[0, 0, 14, 100], [15, 20, 40, 40], [20, 10, 30, 30]], np.float64)
    assert overlap_ratios(thing, people).tolist() == [[0.4, 0.25, 0.0]]


def test_object_without_area_has_ratio_zero() -> None:
    assert overlap_ratios(box(5, 5, 5, 9), box(0, 0, 10, 10)).tolist() == [[0.0]]


@given(boxes(), boxes())
def test_ratio_is_a_share(thing: Box, person: Box) -> None:
    ratio = overlap_ratios(thing, person)[0, 0]
    assert 0.0 <= ratio <= 1.0


@given(boxes())
def test_equal_boxes_give_one(thing: Box) -> None:
    assert overlap_ratios(thing, thing).tolist() == [[1.0]]
    assert intersections_over_union(thing, thing).tolist() == [[1.0]]


@given(boxes(), boxes(), st.floats(0, 100))
def test_disjoint_boxes_give_zero(thing: Box, person: Box, gap: float) -> None:
    shift = thing[0, 2] - person[0, 0] + gap
    beside = person + np.array([shift, 0, shift, 0])
    assert overlap_ratios(thing, beside).tolist() == [[0.0]]


@given(boxes(), boxes(), st.floats(0, 300))
def test_ratio_grows_with_the_shared_area(thing: Box, person: Box, more: float) -> None:
    larger = person + np.array([-more, -more, more, more])
    assert overlap_ratios(thing, larger)[0, 0] >= overlap_ratios(thing, person)[0, 0]


@given(boxes(), boxes(), boxes())
def test_swapping_people_changes_nothing(thing: Box, one: Box, other: Box) -> None:
    forward = overlap_ratios(thing, np.vstack([one, other]))
    backward = overlap_ratios(thing, np.vstack([other, one]))
    assert forward.max() == backward.max()
    assert np.array_equal(forward, backward[:, ::-1])


@given(boxes())
def test_clipping_keeps_what_is_inside(thing: Box) -> None:
    clipped = clip_boxes(thing, 320, 240)
    assert (clipped >= 0).all()
    assert (clipped <= [320, 240, 320, 240]).all()
    assert areas_px2(clipped)[0] <= areas_px2(thing)[0]
