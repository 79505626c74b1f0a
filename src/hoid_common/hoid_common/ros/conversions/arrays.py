"""Conversions between NumPy arrays and the array fields of messages.

Fields are set to an `array.array`. Of any other type rclpy checks every element, which takes 54 ms
for a VGA image (rosidl_python issue 156).
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import MessageError
from hoid_common.values import ByteArray, Float32Array


def bytes_field(values: NDArray[Any] | bytes) -> array[int]:
    return array('B', values if isinstance(values, bytes) else values.tobytes())


def array_field(kind: str, values: NDArray[Any]) -> array[Any]:
    """Return the values of an array as a message field of a type code such as 'f' (float32)."""
    return array(kind, values.astype(np.dtype(kind), copy=False).tobytes())


def float_array(field: Any, name: str, length: int) -> Float32Array:
    """Return a float32 copy (length,) of a float32[] field; MessageError for another length."""
    return _array(field, name, length, np.dtype(np.float32))


def byte_array(field: Any, name: str, length: int) -> ByteArray:
    return _array(field, name, length, np.dtype(np.uint8))


def _array(field: Any, name: str, length: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    if len(field) != length:
        raise MessageError(f'{name} has {len(field)} elements, expected {length}')
    return np.array(field, dtype=dtype) if length else np.empty(0, dtype)
