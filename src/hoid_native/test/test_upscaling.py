"""Nearest-neighbor upscaling at single pixels, against NumPy."""

import numpy as np
import pytest

from hoid_native import values_at


@pytest.mark.parametrize('width', [1, 3, 130, 641, 4096])
def test_every_pixel_has_the_value_of_its_row_and_column(width: int) -> None:
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(0, 9, 40), rng.integers(0, 11, width)
    values = rng.integers(0, 256, (9, 11)).astype(np.uint8)
    found = values_at(np.arange(40 * width), values, rows, columns)
    assert np.array_equal(found.reshape(40, width), values[rows[:, None], columns])
