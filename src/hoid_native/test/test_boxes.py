"""The rules of the HOID paper and overlaps of boxes, against references in NumPy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import (
    box_center_depths_m,
    classify_boxes,
    intersections_over_union,
    overlap_ratios,
)
from hoid_native.boxes import MAY_BE_HANDLED, PERSON
from hoid_native.results import ClassifiedBoxes

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
    """Return (HEIGHT, WIDTH) mask of the pixels whose center is in a box."""
    mask = np.zeros(SHAPE_HW, np.bool_)
    for x1, y1, x2, y2 in np.ceil(np.maximum(boxes, 0)).astype(int).tolist():
        mask[y1:y2, x1:x2] = True
    return mask


def contains(boxes: Boxes, pixels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (N, K) mask of the pixels whose center is in each box."""
    v, u = np.divmod(pixels, WIDTH)
    x1, y1, x2, y2 = boxes.T[:, :, None]
    flags: NDArray[np.bool_] = (u >= x1) & (u < x2) & (v >= y1) & (v < y2)
    return flags


def plain_classification(
    depth_m: NDArray[np.float32],
    pixels: NDArray[np.int64],
    boxes: Boxes,
    roles: NDArray[np.uint8],
    min_share: float,
    apart_m: float,
    reach_px: float,
) -> ClassifiedBoxes:
    people, index = roles == PERSON, np.arange(len(boxes))
    far_m = box_center_depths_m(depth_m, boxes, SIDE_PX)
    overlap = overlap_ratios(boxes, boxes[people])
    gap_m = np.abs(far_m[:, None] - far_m[people])
    near = [-reach_px, -reach_px, reach_px, reach_px]
    seen = contains(boxes, pixels)[:, None] & contains(boxes[people] + near, pixels)
    touches = overlap > min_share if np.isnan(reach_px) else seen.any(axis=2)
    pairs = touches & ~(gap_m >= apart_m)
    best = (overlap + pairs).argmax(axis=1)
    moves = people | (pairs.any(axis=1) & (roles == MAY_BE_HANDLED))
    mask = plain_mask(boxes[moves])
    return ClassifiedBoxes(
        far_m,
        np.where(people, 0.0, overlap[index, best]),
        np.where(people, np.nan, gap_m[index, best]),
        roles * moves,
        np.flatnonzero(~mask.ravel()[pixels]),
        int(np.count_nonzero(~mask)),
    )


@pytest.mark.parametrize('seed', range(20))
@pytest.mark.parametrize('limits', [(0.4, 0.2), (0.4, np.inf), (np.inf, np.inf), (0.0, 0.5)])
def test_boxes_are_classified_like_the_reference(seed: int, limits: tuple[float, float]) -> None:
    rng = np.random.default_rng(seed)
    depth_m = np.kron(rng.uniform(0.5, 2, (9, 13)), np.ones((10, 10))).astype(np.float32)
    depth_m[rng.random(SHAPE_HW) < 0.2] = 0.0
    depth_m[:30, :40] = 0.0
    boxes, pixels = crowd(seed, 25), corners(seed)
    roles = rng.integers(0, 3, 25).astype(np.uint8)
    for reach_px, given in ((np.nan, pixels), (0.0, pixels[:60]), (3.5, pixels[:60])):
        found = classify_boxes(depth_m, given, boxes, roles, SIDE_PX, *limits, reach_px)
        plain = plain_classification(depth_m, given, boxes, roles, *limits, reach_px)
        for got, expected in zip(found, plain, strict=True):
            np.testing.assert_array_equal(got, expected)


def test_without_people_nothing_is_handled() -> None:
    depth_m, pixels = np.ones(SHAPE_HW, np.float32), corners(0)
    roles = np.full(3, MAY_BE_HANDLED, np.uint8)
    found = classify_boxes(depth_m, pixels, crowd(0, 3), roles, SIDE_PX, 0.0, np.inf)
    assert not found.moves.any()
    assert found.overlap.tolist() == [0.0] * 3
    assert np.isnan(found.gap_m).all()
    assert found.outside.tolist() == list(range(len(pixels)))
    assert found.area_px == HEIGHT * WIDTH
    none = classify_boxes(depth_m, pixels[:0], np.empty((0, 4)), roles[:0], SIDE_PX, 0.0, np.inf)
    assert [len(values) for values in none[:5]] == [0] * 5


@pytest.mark.parametrize(
    'beyond', [(-50, -50, 500, 500), (60.2, 20.7, 1e9, 30), (-9, -9, -1, -1), (20, 30, 10, 40)]
)
def test_boxes_beyond_the_image_and_inverted_ones(beyond: Any) -> None:
    boxes, pixels = np.array([beyond], np.float64), np.arange(HEIGHT * WIDTH)
    person = np.array([PERSON], np.uint8)
    depth_m = np.ones(SHAPE_HW, np.float32)
    found = classify_boxes(depth_m, pixels, boxes, person, SIDE_PX, 0.4, 0.2)
    assert np.array_equal(found.outside, np.flatnonzero(~plain_mask(boxes)))
    assert found.area_px == len(found.outside)


def test_ratios_equal_the_reference_also_for_boxes_without_area() -> None:
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
