"""The even selection of corners, against a reference implementation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hoid_native import spread_evenly


def test_weak_corner_alone_beats_strong_ones_in_a_crowd() -> None:
    crowd = np.column_stack([np.linspace(0, 9, 10), np.zeros(10)])
    uv_px = np.vstack([crowd, [[95.0, 95.0]]]).astype(np.float32)
    score = np.r_[np.full(10, 50), 8].astype(np.uint8)
    kept = spread_evenly(uv_px, np.zeros(11, np.uint8), score, np.array([4]), 100.0 * 100.0)
    assert 10 in kept
    assert len(kept) == 4


def test_budget_an_octave_cannot_use_goes_to_the_others() -> None:
    rng = np.random.default_rng(1)
    uv_px = rng.uniform(0, 100, (60, 2)).astype(np.float32)
    octave = np.r_[np.zeros(55), np.ones(5)].astype(np.uint8)
    kept = spread_evenly(uv_px, octave, np.ones(60, np.uint8), np.array([20, 20]), 1e4)
    assert len(kept) == 40
    assert (octave[kept] == 1).sum() == 5


@settings(max_examples=50)
@given(st.integers(0, 400), st.integers(0, 2**32 - 1))
def test_keeps_the_budget_without_repeats(num: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    budgets = np.array([50, 30, 20])
    kept = spread_evenly(
        rng.uniform(0, 300, (num, 2)).astype(np.float32),
        rng.integers(0, 3, num).astype(np.uint8),
        rng.integers(7, 99, num).astype(np.uint8),
        budgets,
        9e4,
    )
    assert len(kept) == min(num, 100)
    assert len(np.unique(kept)) == len(kept)


def by_definition(
    uv_px: NDArray[np.float64],
    octave: NDArray[np.uint8],
    score: NDArray[np.uint8],
    budgets: NDArray[np.int64],
    area_px: float,
) -> list[int]:
    """Return the indices of the corners to keep, selected one by one as defined."""
    per_px = np.sqrt(np.maximum(budgets, 1) / area_px).astype(np.float32)
    cell = (uv_px * per_px[octave][:, None]).astype(int)
    in_cell: dict[tuple[int, ...], int] = {}
    rank = np.zeros(len(octave), int)
    for k in sorted(range(len(octave)), key=lambda k: (-int(score[k]), k)):
        of = (int(octave[k]), *cell[k].tolist())
        rank[k] = in_cell[of] = in_cell.get(of, -1) + 1
    order = sorted(
        range(len(octave)), key=lambda k: (int(octave[k]), int(rank[k]), -int(score[k]), k)
    )
    left = budgets.copy()
    kept: list[tuple[int, int]] = []
    spare: list[tuple[int, int]] = []
    for k in order:
        left[octave[k]] -= 1
        (kept if left[octave[k]] >= 0 else spare).append((max(-int(left[octave[k]]), 0), k))
    more = sorted(spare, key=lambda pair: pair[0])[: int(budgets.sum()) - len(kept)]
    return sorted(k for _, k in kept + more)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from([500.0, 9e4, 1e9]))
def test_the_selection_follows_the_definition(seed: int, area_px: float) -> None:
    rng = np.random.default_rng(seed)
    num = int(rng.integers(0, 500))
    uv_px = rng.uniform(0, 300, (num, 2))
    octave = rng.choice([0, 0, 0, 1, 3], num).astype(np.uint8)
    score = rng.integers(7, 20, num).astype(np.uint8)
    budgets = np.array([50, 30, 20, 0])
    kept = spread_evenly(uv_px, octave, score, budgets, area_px)
    assert kept.tolist() == by_definition(uv_px, octave, score, budgets, area_px)


def test_positions_on_no_grid_are_refused() -> None:
    uv_px, octave = np.ones((1, 2)), np.zeros(1, np.uint8)
    score, budgets = octave + np.uint8(9), np.array([1])
    assert spread_evenly(uv_px, octave, score, budgets, 0.0).tolist() == [0]
    for wrong_px in (-1, np.nan, np.inf, 1e9):
        with pytest.raises(ValueError, match='uv_px'):
            spread_evenly(uv_px * wrong_px, octave, score, budgets, 100.0)
    with pytest.raises(ValueError, match='octave'):
        spread_evenly(uv_px, octave + np.uint8(1), score, budgets, 100.0)
    with pytest.raises(ValueError, match='budgets'):
        spread_evenly(uv_px, octave, score, -budgets, 100.0)
    with pytest.raises(ValueError, match='area_px'):
        spread_evenly(uv_px, octave, score, budgets, -1.0)
