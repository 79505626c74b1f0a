"""Masks over a small image, against the plain form."""

import cv2
import numpy as np
import pytest

from hoid_native import values_at, widen


@pytest.mark.parametrize('shape', [(1, 1), (7, 3), (48, 64), (120, 161)])
@pytest.mark.parametrize('reach_px', [0, 1, 2, 3, 9])
def test_widens_as_a_dilation(shape: tuple[int, int], reach_px: int) -> None:
    side = 2 * reach_px + 1
    for seed in range(10):
        rng = np.random.default_rng(seed)
        mask = rng.integers(1, 4, shape).astype(np.uint8) * (rng.random(shape) < 0.02)
        expected = cv2.dilate((mask > 0).astype(np.uint8), np.ones((side, side), np.uint8))
        np.testing.assert_array_equal(widen(mask, reach_px), expected)


@pytest.mark.parametrize('width', [1, 3, 130, 641, 4096])
def test_values_at_every_pixel(width: int) -> None:
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(0, 9, 40), rng.integers(0, 11, width)
    values = rng.integers(0, 256, (9, 11)).astype(np.uint8)
    found = values_at(np.arange(40 * width), values, rows, columns)
    assert np.array_equal(found.reshape(40, width), values[rows[:, None], columns])
