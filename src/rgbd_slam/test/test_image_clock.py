"""Time that passes while nothing is recognised, by stamps of all kinds."""

from __future__ import annotations

import pytest

from rgbd_slam.tracking.image_clock import ImageClock

S = 1_000_000_000


def lost_s(*stamps_s: float) -> float:
    clock = ImageClock()
    assert not any(clock.add(round(S * stamp_s)) for stamp_s in stamps_s)
    return clock.lost_s


def test_time_is_counted_from_image_to_image() -> None:
    assert lost_s(7.0) == 0
    assert lost_s(7.0, 7.1, 7.3) == pytest.approx(0.3)


def test_a_gap_counts_as_half_a_second_at_most() -> None:
    assert lost_s(7.0, 17.0) == pytest.approx(0.5)
    assert lost_s(7.0, 7.4, 17.0, 17.1) == pytest.approx(1.0)


def test_stamps_that_stand_still_or_change_places_count_once() -> None:
    assert lost_s(7.0, 7.2, 7.2, 7.1, 7.3) == pytest.approx(0.3)
    assert lost_s(7.0, 6.0, 6.5, 7.1) == pytest.approx(0.1)


def test_what_is_recognised_is_where_counting_begins() -> None:
    clock = ImageClock()
    for stamp_ns in (7 * S, 7 * S + S // 4):
        clock.add(stamp_ns)
    clock.recognised()
    assert clock.lost_s == 0
    clock.add(7 * S + S // 2)
    assert clock.lost_s == 0.25


def test_stamps_that_go_back_far_start_time_anew() -> None:
    clock = ImageClock()
    assert not clock.add(100 * S)
    clock.add(100 * S + S // 4)
    assert clock.add(3 * S)
    assert clock.lost_s == 0
    assert not clock.add(3 * S + S // 4)
    assert clock.lost_s == 0.25
