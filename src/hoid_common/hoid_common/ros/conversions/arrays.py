"""Arrays to and from the flat array fields of messages.

Fields are set from `array.array`: rclpy checks every element of anything else, which takes 54 ms
for one VGA picture.
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import MessageError
from hoid_common.values import ByteArray, Float32Array


def bytes_field(values: NDArray[Any] | bytes) -> array[int]:
    """Return the raw bytes of an array, for a uint8[] field."""
    field = array('B')
    field.frombytes(values if isinstance(values, bytes) else values.tobytes())
    return field


def floats_field(values: NDArray[Any]) -> array[float]:
    """Return the values as float32, for a float32[] field."""
    field = array('f')
    field.frombytes(values.astype(np.float32, copy=False).tobytes())
    return field


def float_array(field: Any, name: str, length: int) -> Float32Array:
    """Return a (length,) copy of a float32[] field; another length raises MessageError."""
    return _array(field, name, length, np.dtype(np.float32))


def byte_array(field: Any, name: str, length: int) -> ByteArray:
    """Return a (length,) copy of a uint8[] field; another length raises MessageError."""
    return _array(field, name, length, np.dtype(np.uint8))


def _array(field: Any, name: str, length: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    if len(field) != length:
        raise MessageError(f'{name} has {len(field)} elements, expected {length}')
    return np.array(field, dtype=dtype) if length else np.empty(0, dtype)
