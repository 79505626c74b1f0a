"""Rules for the arrays of a map from a file, so that no file can harm the program."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.errors import MapFileError
from hoid_common.values import FloatArray

MAX_POSITION_M = 1e5  # chosen: no map is larger, and squares of positions keep their precision
MAX_COUNT = 2**40  # chosen: no sum of two counts overflows
# Chosen: range of weights, so that no product with a color or a coordinate overflows.
MIN_WEIGHT, MAX_WEIGHT = 1e-30, 1e30


def require(holds: bool | np.bool_, otherwise: str) -> None:
    if not holds:
        raise MapFileError(otherwise)


def within(values: NDArray[Any], low: float, end: float) -> bool:
    """Return whether all values are in [low, end): true without values, false if one is NaN."""
    return values.size == 0 or bool(values.min() >= low and values.max() < end)


def are_poses(T: FloatArray) -> bool:
    """Return whether all (N, 4, 4) are rigid, with positions in the range of a map."""
    return bool((se3.is_rigid(T) & (np.abs(T) < MAX_POSITION_M).all((1, 2))).all())
