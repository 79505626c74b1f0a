"""Even choice of features: many corners in, a budget of well-spread ones out."""

from __future__ import annotations

import numpy as np

from hoid_common.values import ByteArray, Float32Array, IntArray


def octave_budgets(num_features: int, num_levels: int, scale_factor: float) -> IntArray:
    """Return the features of each octave, (num_levels,), in proportion to 1 / scale."""
    weights = scale_factor ** -np.arange(num_levels, dtype=np.float64)
    ends = np.round(np.cumsum(weights) / weights.sum() * num_features).astype(np.int64)
    return np.concatenate([ends[:1], ends[1:] - ends[:-1]])


def spread_evenly(
    uv_px: Float32Array,
    octave: ByteArray,
    response: Float32Array,
    budgets: IntArray,
    area_px: float,
) -> IntArray:
    """Return the indices (ascending) of the features to keep, at most `budgets.sum()` of N.

    Each octave lays a grid of about as many cells as its budget over the area to fill. The
    strongest corner of every cell goes first, then the second of every cell, and so on until the
    octave's budget is spent. What octaves with few corners leave over goes to the others.

    Args:
        uv_px: (N, 2) level-0 pixels, not negative.
        area_px: image area, in level-0 pixels, that the budget is to fill.
    """
    num = len(octave)
    total = int(budgets.sum())
    if num <= total:
        return np.arange(num)
    cell_px = np.sqrt(area_px / np.maximum(budgets, 1)).astype(np.float32)[octave]
    cell = (uv_px / cell_px[:, None]).astype(np.int64)
    key = (octave.astype(np.int64) << 40) | (cell[:, 1] << 20) | cell[:, 0]
    by_cell = np.lexsort((-response, key))
    rank = _rank_in_runs(key[by_cell])
    order = np.lexsort((-response[by_cell], rank, octave[by_cell]))
    place = _rank_in_runs(octave[by_cell][order])  # place in the octave's queue
    surplus = place - budgets[octave[by_cell][order]]
    kept = by_cell[order[np.argsort(np.maximum(surplus, -1), kind='stable')[:total]]]
    return np.sort(kept)


def _rank_in_runs(sorted_keys: IntArray | ByteArray) -> IntArray:
    """Return each element's position within its run of equal keys."""
    index = np.arange(len(sorted_keys))
    starts = np.flatnonzero(np.diff(sorted_keys, prepend=sorted_keys[:1]) != 0)
    first = np.zeros(len(sorted_keys), np.int64)
    first[starts] = starts
    return index - np.maximum.accumulate(first)
