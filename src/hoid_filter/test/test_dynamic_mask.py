"""The mask over dynamic pixels, and the corners that it keeps."""

import cv2
import numpy as np

from hoid_filter.strategies import dynamic_mask
from hoid_filter.strategies.dynamic_mask import masked
from hoid_filter.strategy import ObjectVerdicts

from .helpers import HEIGHT, WIDTH, picture_of, view

NOTHING = ObjectVerdicts.of(np.empty((0, 4), np.float32), (), np.empty(0, np.float32), ())
LOW_HW = (HEIGHT // 4, WIDTH // 4)


def test_corners_on_dynamic_pixels_and_within_the_margin_are_dropped() -> None:
    is_dynamic = np.zeros(LOW_HW, np.bool_)
    is_dynamic[10:20, 15:25] = True
    mask = masked(is_dynamic, view(None), NOTHING)
    expected = np.ones((HEIGHT, WIDTH), np.bool_)
    expected[32:88, 52:108] = False  # full-resolution pixels of the region and 8 px around it
    np.testing.assert_array_equal(picture_of(mask.kept), expected)
    assert mask.static_area_px == np.count_nonzero(expected)
    np.testing.assert_array_equal(mask.dynamic_mask, ~expected[::4, ::4])


def test_a_mask_over_the_whole_image_keeps_no_corner() -> None:
    mask = masked(np.ones(LOW_HW, np.bool_), view(None), NOTHING)
    assert mask.static_area_px == 0
    assert not picture_of(mask.kept).any()


def test_a_static_image_keeps_all_corners() -> None:
    mask = masked(np.zeros(LOW_HW, np.bool_), view(None), NOTHING)
    assert (mask.static_area_px, mask.kept) == (HEIGHT * WIDTH, None)
    assert mask.dynamic_mask is not None
    assert not mask.dynamic_mask.any()


def test_each_pixel_has_the_low_resolution_cell_that_opencv_resizes_to_it() -> None:
    cells = np.arange(31 * 43, dtype=np.float32).reshape(31, 43)
    found = dynamic_mask._upsampling((123, 170), (31, 43))
    expected = cv2.resize(cells, (170, 123), interpolation=cv2.INTER_NEAREST)
    np.testing.assert_array_equal(found.cell_of_pixel, expected.ravel())
    np.testing.assert_array_equal(found.areas_px.ravel(), np.bincount(found.cell_of_pixel))
