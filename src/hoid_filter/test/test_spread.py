from hypothesis import given
from hypothesis import strategies as st

from hoid_filter.extraction.spread import octave_budgets


def test_budgets_follow_inverse_scale() -> None:
    assert octave_budgets(1000, 8, 1.2).tolist() == [217, 181, 151, 126, 104, 88, 72, 61]


@given(st.integers(50, 5000), st.integers(1, 16), st.floats(1.01, 2.0))
def test_budgets_add_up(num: int, levels: int, scale: float) -> None:
    budgets = octave_budgets(num, levels, scale)
    assert budgets.sum() == num
    assert (budgets >= 0).all()
