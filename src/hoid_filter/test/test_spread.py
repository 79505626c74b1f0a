import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hoid_filter.extraction.spread import octave_budgets, spread_evenly


def test_budgets_follow_inverse_scale() -> None:
    assert octave_budgets(1000, 8, 1.2).tolist() == [217, 181, 151, 126, 104, 88, 72, 61]


@given(st.integers(50, 5000), st.integers(1, 16), st.floats(1.01, 2.0))
def test_budgets_add_up(num: int, levels: int, scale: float) -> None:
    budgets = octave_budgets(num, levels, scale)
    assert budgets.sum() == num
    assert (budgets >= 0).all()


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


@settings(max_examples=50, deadline=None)
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
