"""The mask over dynamic objects, and the order in which it is relaxed."""

import numpy as np
import pytest

from hoid_filter.config import PlusConfig
from hoid_filter.strategies.dynamic_mask import Masks, make_masks
from hoid_filter.strategy import FilterInput

from .helpers import HEIGHT, WIDTH, view

REMEMBERED, HANDLED, PERSON = 1, 2, 3
# Columns of the image, and of the small image, a quarter of that.
PERSON_X, HANDLED_X, REMEMBERED_X, FREE_X = 20, 70, 110, 155
BEYOND_MARGIN_X = 148


def certainty() -> np.ndarray:
    """Return a low-resolution mask: person, handled object, remembered object, static strip."""
    small = np.zeros((HEIGHT // 4, WIDTH // 4), np.uint8)
    small[:, :15], small[:, 15:25], small[:, 25:35] = PERSON, HANDLED, REMEMBERED
    return small


def seen(column: int, num_with_depth: int, num_without: int = 0) -> FilterInput:
    """Return an input whose corners are the top row, without depth, and those of one column."""
    rows = range(1, 1 + num_with_depth + num_without)
    depth_m = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth_m[0] = depth_m[1 + num_with_depth :] = 0.0
    top_row = tuple((x, 0) for x in range(WIDTH))
    return view(None, depth_m, top_row + tuple((column, y) for y in rows))


def mapped_columns(masks: Masks) -> list[int]:
    """Return the columns of the top row whose corners may become map points."""
    assert masks.seeds is not None
    return np.flatnonzero(masks.seeds[:WIDTH]).tolist()


@pytest.mark.parametrize(
    ('column', 'step', 'kept'),
    [
        (FREE_X, 0, {FREE_X}),
        (REMEMBERED_X, 1, {REMEMBERED_X, FREE_X}),
        (HANDLED_X, 2, {HANDLED_X, REMEMBERED_X, FREE_X}),
    ],
)
def test_the_least_certain_objects_are_unmasked_first(
    column: int, step: int, kept: set[int]
) -> None:
    masks = make_masks(certainty(), seen(column, 10), PlusConfig(), min_corners=10)
    assert masks.step == step
    assert masks.kept is not None
    columns = {PERSON_X, HANDLED_X, REMEMBERED_X, FREE_X}
    assert columns.intersection(masks.kept.tolist()) == kept
    assert masks.static_area_px == HEIGHT * np.count_nonzero(masks.kept < WIDTH)
    if step == 0:
        assert masks.seeds is None
    else:
        assert mapped_columns(masks) == list(range(BEYOND_MARGIN_X, WIDTH))


def test_the_last_step_unmasks_everything_but_maps_no_dynamic_corner() -> None:
    masks = make_masks(certainty(), seen(PERSON_X, 10), PlusConfig(), min_corners=10)
    assert (masks.kept, masks.static_area_px, masks.step) == (None, HEIGHT * WIDTH, 3)
    assert mapped_columns(masks) == list(range(BEYOND_MARGIN_X, WIDTH))


def test_corners_without_depth_do_not_count() -> None:
    assert make_masks(certainty(), seen(FREE_X, 9, 50), PlusConfig(), min_corners=10).step == 3
    assert make_masks(certainty(), seen(FREE_X, 10, 50), PlusConfig(), min_corners=10).step == 0


def test_without_the_fallback_the_mask_stays() -> None:
    masks = make_masks(certainty(), seen(FREE_X, 0), PlusConfig(fall_back=False), min_corners=10)
    assert masks.step == 0
    assert masks.kept is not None
    assert masks.kept.min() >= 140


def test_nothing_moves_nothing_masked() -> None:
    masks = make_masks(np.zeros((30, 40), np.uint8), seen(FREE_X, 0), PlusConfig(), min_corners=10)
    assert masks == (HEIGHT * WIDTH, None, None, 0, None)
