"""The rules of the HOID paper and what boxes cover, against the plain form of both."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import (
    boxes_holding,
    cells_of,
    intersections_over_union,
    judge_boxes,
    outside_boxes,
    overlap_ratios,
    sample_depths_m,
)
from hoid_native.boxes import MAY_BE_HANDLED, PERSON, Judged

HEIGHT, WIDTH, SIDE_PX = 90, 130, 10
SHAPE_HW = HEIGHT, WIDTH
Boxes = NDArray[np.float64]


def crowd(seed: int, num: int) -> Boxes:
    """Return boxes inside the image, some of them with whole pixels as corners."""
    rng = np.random.default_rng(seed)
    first = rng.uniform(0, (WIDTH - 2, HEIGHT - 2), (num, 2))
    last = first + rng.uniform(1, 60, (num, 2))
    boxes: Boxes = np.concatenate([first, np.minimum(last, (WIDTH, HEIGHT))], 1)
    boxes[::3] = np.round(boxes[::3])
    return boxes


def corners(seed: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(0, HEIGHT * WIDTH, 3000)


def plain_mask(boxes: Boxes) -> NDArray[np.bool_]:
    """Return (HEIGHT, WIDTH) flags of the pixels whose centre is in a box."""
    mask = np.zeros(SHAPE_HW, np.bool_)
    for x1, y1, x2, y2 in np.ceil(np.maximum(boxes, 0)).astype(int).tolist():
        mask[y1:y2, x1:x2] = True
    return mask


def plain_judgement(
    depth_m: NDArray[np.float32],
    boxes: Boxes,
    roles: NDArray[np.uint8],
    min_share: float,
    apart_m: float,
    touches: NDArray[np.bool_] | None,
) -> Judged:
    people, index = roles == PERSON, np.arange(len(boxes))
    far_m = sample_depths_m(depth_m, boxes, SIDE_PX)
    overlap = overlap_ratios(boxes, boxes[people])
    gap_m = np.abs(far_m[:, None] - far_m[people])
    pairs = (overlap > min_share if touches is None else touches) & ~(gap_m >= apart_m)
    best = (overlap + pairs).argmax(axis=1)
    return Judged(
        far_m,
        np.where(people, 0.0, overlap[index, best]),
        np.where(people, np.nan, gap_m[index, best]),
        people | (pairs.any(axis=1) & (roles == MAY_BE_HANDLED)),
    )


@pytest.mark.parametrize('seed', range(20))
@pytest.mark.parametrize('limits', [(0.4, 0.2), (0.4, np.inf), (np.inf, np.inf), (0.0, 0.5)])
def test_judges_as_the_plain_form(seed: int, limits: tuple[float, float]) -> None:
    rng = np.random.default_rng(seed)
    depth_m = np.kron(rng.uniform(0.5, 2, (9, 13)), np.ones((10, 10))).astype(np.float32)
    depth_m[rng.random(SHAPE_HW) < 0.2] = 0.0
    depth_m[:30, :40] = 0.0
    boxes = crowd(seed, 25)
    roles = rng.integers(0, 3, 25).astype(np.uint8)
    touches = rng.random((25, np.count_nonzero(roles == PERSON))) < 0.2
    for given in (None, touches):
        found = judge_boxes(depth_m, boxes, roles, SIDE_PX, *limits, given)
        for got, expected in zip(
            found, plain_judgement(depth_m, boxes, roles, *limits, given), strict=True
        ):
            np.testing.assert_array_equal(got, expected)


def test_without_people_nothing_is_handled() -> None:
    depth_m = np.ones(SHAPE_HW, np.float32)
    roles = np.full(3, MAY_BE_HANDLED, np.uint8)
    found = judge_boxes(depth_m, crowd(0, 3), roles, SIDE_PX, 0.0, np.inf)
    assert not found.moves.any()
    assert found.overlap.tolist() == [0.0] * 3
    assert np.isnan(found.gap_m).all()
    none = judge_boxes(depth_m, np.empty((0, 4)), roles[:0], SIDE_PX, 0.0, np.inf)
    assert [len(values) for values in none] == [0] * 4


@pytest.mark.parametrize('num', [0, 1, 12])
def test_outside_boxes_is_what_a_drawn_mask_leaves(num: int) -> None:
    for seed in range(20):
        boxes, pixels = crowd(seed, num), corners(seed)
        outside, area_px = outside_boxes(pixels, boxes, SHAPE_HW)
        mask = plain_mask(boxes)
        np.testing.assert_array_equal(outside, np.flatnonzero(~mask.ravel()[pixels]))
        assert area_px == np.count_nonzero(~mask)


@pytest.mark.parametrize(
    'beyond', [(-50, -50, 500, 500), (60.2, 20.7, 1e9, 30), (-9, -9, -1, -1), (20, 30, 10, 40)]
)
def test_boxes_beyond_the_image_and_inverted_ones(beyond: Any) -> None:
    boxes, pixels = np.array([beyond], np.float64), np.arange(HEIGHT * WIDTH)
    outside, area_px = outside_boxes(pixels, boxes, SHAPE_HW)
    assert np.array_equal(outside, np.flatnonzero(~plain_mask(boxes)))
    assert area_px == len(outside)


def test_boxes_holding_a_pixel() -> None:
    for seed in range(20):
        boxes, pixels = crowd(seed, 40), corners(seed)[:100]
        boxes[::2, 2:] = boxes[::2, :2] + 4
        boxes[::5, 2] = boxes[::5, 0] - 1  # inverted: nothing in them
        v, u = np.divmod(pixels, WIDTH)
        x1, y1, x2, y2 = boxes.T[:, :, None]
        inside = (u >= x1) & (u < x2) & (v >= y1) & (v < y2)
        np.testing.assert_array_equal(boxes_holding(pixels, boxes, SHAPE_HW), inside.any(axis=1))


def test_ratios_are_the_plain_ones_for_boxes_without_area_too() -> None:
    boxes, others = crowd(0, 30), crowd(1, 20)
    boxes[5, 2] = boxes[5, 0]
    others[7] = boxes[5]
    sides = np.minimum(boxes[:, None, 2:], others[:, 2:])
    sides = np.maximum(sides - np.maximum(boxes[:, None, :2], others[:, :2]), 0.0)
    shared = sides[..., 0] * sides[..., 1]
    own, other = ((b[:, 2] - b[:, 0]) * (b[:, 3] - b[:, 1]) for b in (boxes, others))
    zero = np.zeros_like(shared)
    share = np.divide(shared, own[:, None], out=zero.copy(), where=own[:, None] > 0)
    np.testing.assert_array_equal(overlap_ratios(boxes, others), share)
    joint = own[:, None] + other - shared
    iou = np.divide(shared, joint, out=zero.copy(), where=joint > 0)
    np.testing.assert_array_equal(intersections_over_union(boxes, others), iou)


@pytest.mark.parametrize('width', [1, 3, 130, 641, 4096])
def test_cells_of_every_pixel(width: int) -> None:
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(0, 99, 40), rng.integers(0, 99, width)
    expected = (rows[:, None] + columns).ravel()
    assert np.array_equal(cells_of(np.arange(40 * width), rows, columns), expected)
