"""The time for which the camera is lost, with gaps, repeated stamps and stamps that go back."""

from __future__ import annotations

import pytest

from rgbd_slam.tracking.loss import LossTimer

S = 1_000_000_000


def lost_s(*stamps_s: float) -> float:
    timer = LossTimer()
    assert not any(timer.add(round(S * stamp_s)) for stamp_s in stamps_s)
    return timer.lost_s


def test_the_time_between_images_adds_up() -> None:
    assert lost_s(7.0) == 0
    assert lost_s(7.0, 7.1, 7.3) == pytest.approx(0.3)


def test_a_gap_counts_as_half_a_second_at_most() -> None:
    assert lost_s(7.0, 17.0) == pytest.approx(0.5)
    assert lost_s(7.0, 7.4, 17.0, 17.1) == pytest.approx(1.0)


def test_equal_and_swapped_stamps_count_once() -> None:
    assert lost_s(7.0, 7.2, 7.2, 7.1, 7.3) == pytest.approx(0.3)
    assert lost_s(7.0, 6.0, 6.5, 7.1) == pytest.approx(0.1)


def test_a_reset_starts_at_the_latest_image() -> None:
    timer = LossTimer()
    for stamp_ns in (7 * S, 7 * S + S // 4):
        timer.add(stamp_ns)
    timer.reset()
    assert timer.lost_s == 0
    timer.add(7 * S + S // 2)
    assert timer.lost_s == 0.25


def test_stamps_that_jump_back_far_restart_the_timer() -> None:
    timer = LossTimer()
    assert not timer.add(100 * S)
    timer.add(100 * S + S // 4)
    assert timer.add(3 * S)
    assert timer.lost_s == 0
    assert not timer.add(3 * S + S // 4)
    assert timer.lost_s == 0.25
