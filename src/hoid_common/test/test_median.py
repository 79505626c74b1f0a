"""The quick median is NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.median import median
from hoid_common.values import FloatArray


@pytest.mark.parametrize('shape', [(1,), (2,), (7,), (1000,), (5, 3), (6, 3)])
@pytest.mark.parametrize('dtype', [np.float32, np.float64])
def test_it_is_numpys_bit_for_bit(shape: tuple[int, ...], dtype: type) -> None:
    values: FloatArray = np.random.default_rng(0).normal(size=shape).astype(dtype)
    found = median(values)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.median(values, axis=0))


def test_infinity_has_its_place() -> None:
    assert median(np.array([np.inf, 1.0, 2.0])) == 2.0
