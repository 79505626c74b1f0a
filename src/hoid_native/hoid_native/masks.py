"""Masks over a small image, and what they say of the pixels of the full one."""

from __future__ import annotations

from ctypes import c_int32, c_void_p

import numpy as np
from numpy.typing import NDArray

from hoid_native.arguments import address, contiguous
from hoid_native.library import declare

_widen = declare('hoid_widen', c_void_p, *[c_int32] * 3, c_void_p)
_values_at = declare('hoid_values_at', *[c_int32] * 2, *[c_void_p] * 3, c_int32, *[c_void_p] * 2)


def widen(mask: NDArray[np.uint8], reach_px: int) -> NDArray[np.uint8]:
    """Return (H, W) flags of pixels with one that is not 0 within reach along rows and columns."""
    height, width = mask.shape
    given = contiguous(mask, np.uint8)
    out = np.empty((height, width), np.uint8)
    _widen(address(given), width, height, reach_px, address(out))
    return out


def values_at(
    pixels: NDArray[np.int64],
    values: NDArray[np.uint8],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> NDArray[np.uint8]:
    """Return values[rows[v], columns[u]] for each (u, v) of K pixels.

    Args:
        pixels: (K,) indices in the flat (H, W) image.
        values: (h, w).
        rows: (H,).
        columns: (W,).

    """
    (width,), (k,), (_, small_width) = columns.shape, pixels.shape, values.shape
    tables = contiguous(rows, np.int64), contiguous(columns, np.int64)
    flat, small = contiguous(pixels, np.int64), contiguous(values, np.uint8)
    out = np.empty(k, np.uint8)
    _values_at(
        width, small_width, *map(address, tables), address(small), k, address(flat), address(out)
    )
    return out
