"""Even choice of features: many corners in, a budget of well-spread ones out."""

from __future__ import annotations

import numpy as np

from hoid_common.values import ByteArray, Float32Array, IntArray

_INDEX_BITS = 20  # a million corners
_WEAKNESS_BITS = 8
_INDEX_MASK = (1 << _INDEX_BITS) - 1
_CELL_BITS = 14  # cells along one side


def octave_budgets(num_features: int, num_levels: int, scale_factor: float) -> IntArray:
    """Return the features of each octave, (num_levels,), in proportion to 1 / scale."""
    weights = scale_factor ** -np.arange(num_levels, dtype=np.float64)
    ends = np.round(np.cumsum(weights) / weights.sum() * num_features).astype(np.int64)
    return np.concatenate([ends[:1], ends[1:] - ends[:-1]])


def spread_evenly(
    uv_px: Float32Array,
    octave: ByteArray,
    score: ByteArray,
    budgets: IntArray,
    area_px: float,
) -> IntArray:
    """Return the indices (ascending) of the corners to keep, at most `budgets.sum()` of N.

    Each octave lays a grid of about as many cells as its budget over the area to fill. The
    strongest corner of every cell goes first, then the second of every cell, and so on until the
    octave's budget is spent. What octaves with few corners leave over goes to the others.

    Args:
        uv_px: (N, 2) level-0 pixels, not negative.
        score: (N,), higher is stronger.
        area_px: image area, in level-0 pixels, that the budget is to fill.
    """
    num, total = len(octave), int(budgets.sum())
    if num <= total:
        return np.arange(num)
    per_px = np.sqrt(np.maximum(budgets, 1) / area_px).astype(np.float32)[octave]
    column, row = ((uv_px[:, axis] * per_px).astype(np.int64) for axis in (0, 1))
    level = octave.astype(np.int64)
    place = (level << 2 * _CELL_BITS) | (row << _CELL_BITS) | column
    # Whole keys are sorted, index included: several times as fast as a stable argsort, and as
    # free of ties.
    weakness = ((255 - score.astype(np.int64)) << _INDEX_BITS) | np.arange(num)
    by_cell = np.sort((place << _WEAKNESS_BITS + _INDEX_BITS) | weakness) & _INDEX_MASK
    rank = np.empty(num, np.int64)
    rank[by_cell] = _rank_in_runs(place[by_cell])
    queue_key = (((level << _INDEX_BITS) | rank) << _WEAKNESS_BITS + _INDEX_BITS) | weakness
    queue = np.sort(queue_key) & _INDEX_MASK
    queued = octave[queue]
    surplus = _rank_in_runs(queued) - budgets[queued]
    within = surplus < 0
    kept, spare = queue[within], queue[~within]
    missing = total - len(kept)
    more = spare[np.argsort(surplus[~within], kind='stable')[:missing]] if missing else spare[:0]
    return np.sort(np.concatenate([kept, more]))


def _rank_in_runs(sorted_keys: IntArray | ByteArray) -> IntArray:
    """Return each element's position within its run of equal keys."""
    is_first = np.ones(len(sorted_keys), np.bool_)
    is_first[1:] = sorted_keys[1:] != sorted_keys[:-1]
    starts = np.flatnonzero(is_first)
    return np.arange(len(sorted_keys)) - np.repeat(
        starts, np.diff(starts, append=len(sorted_keys))
    )
