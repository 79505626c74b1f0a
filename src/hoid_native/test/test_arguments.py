"""What kernels are given for arrays."""

from ctypes import addressof, c_void_p

import numpy as np
import pytest

from hoid_native.arguments import address, contiguous


@pytest.mark.parametrize('shape', [(3, 4), (0, 4), ()])
@pytest.mark.parametrize('writeable', [True, False])
def test_address_is_where_the_values_lie(shape: tuple[int, ...], writeable: bool) -> None:
    array = np.zeros(shape)
    array.flags.writeable = writeable
    given = address(array)
    start = given.value if isinstance(given, c_void_p) else addressof(given)
    assert start == array.ctypes.data


def test_what_is_fit_is_not_copied_and_the_rest_is() -> None:
    array = np.arange(12.0).reshape(3, 4)
    assert contiguous(array, np.float64, 3, 4) is array
    for other in (array.T, array[:, ::2], array.astype(np.float32)):
        copy = contiguous(other, np.float64)
        assert copy.flags.c_contiguous
        np.testing.assert_array_equal(copy, other)


def test_an_array_with_gaps_has_no_address() -> None:
    with pytest.raises(TypeError, match='contiguous'):
        address(np.zeros((3, 4))[:, ::2])


def test_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r'expected an array of shape \(5, 4\), not \(3, 4\)'):
        contiguous(np.zeros((3, 4)), np.float64, 5, 4)
