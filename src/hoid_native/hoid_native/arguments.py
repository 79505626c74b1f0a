"""What kernels are given for arrays."""

from __future__ import annotations

from ctypes import c_char, c_void_p
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_memory_of: Any = (c_char * 0).from_buffer  # of any length


def contiguous(array: NDArray[Any], dtype: DTypeLike, *shape: int) -> NDArray[Any]:
    """Return an array as a kernel reads it: contiguous and of one type, copied where it is not.

    Args:
        array: any.
        dtype: of the kernel's argument.
        shape: which the array must have; nothing: any.

    Raises:
        ValueError: The array has another shape; the kernel would read beyond its end.

    """
    if shape and array.shape != shape:
        raise ValueError(f'expected an array of shape {shape}, not {array.shape}')
    return np.ascontiguousarray(array, dtype)


def address(array: NDArray[Any]) -> Any:
    """Return an argument of type `c_void_p`: where an array without gaps lies; it keeps it alive.

    `array.ctypes.data` takes six times as long as what serves for all arrays but read-only ones.
    """
    if array.flags.writeable:
        return _memory_of(array)
    return array.ctypes.data_as(c_void_p)
