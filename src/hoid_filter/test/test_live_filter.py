"""The states of an image in the live filter: held, published, re-evaluated, final."""

from __future__ import annotations

import pytest

from hoid_common.errors import MessageError
from hoid_filter.config import STOP

from .live_bench import MS, Bench, FakeFilter, S, frame_at, started


def test_an_image_is_published_at_once_and_gets_a_final_verdict_by_its_own_detections() -> None:
    bench = started()
    assert bench.add_image(10, 0.0) == [((10, None), True)]
    assert bench.detect(10, 0.05) == [(10, 10)]
    assert bench.num_without_detections == 0
    assert bench.add_image(20, 0.06) == [((20, None), True)]  # each detections are given once


def test_the_first_images_are_held_until_the_detector_answers_and_published_one_by_one() -> None:
    bench = Bench(wait_s=1.0)
    for i in range(3):
        assert bench.add_image(10 + i, 0.1 * i) == []
    bench.detect(10, 0.3)
    assert bench.published == [((10, 10), False)]
    bench.poll(0.35)
    assert bench.published[1:] == [((11, None), True)]
    bench.poll(0.4)
    assert bench.published[2:] == [((12, None), True)]


def test_a_held_image_is_published_when_the_wait_is_over() -> None:
    bench = Bench(wait_s=0.5)
    assert bench.add_image(10, 0.0) == []
    bench.poll(0.49)
    assert bench.published == []
    bench.poll(0.5)
    assert bench.published == [((10, None), True)]


def test_images_are_held_again_after_the_stamps_restart() -> None:
    bench = started()
    bench.add_image(10 * S, 0.1)
    assert bench.add_image(2, 0.2) == []
    assert bench.counts['times that stamps went back'] == 1
    assert bench.diagnostics.notes == [
        'the stamps went back, as where a bag starts again: all objects are forgotten'
    ]
    assert bench.filter.num_resets == 1


def test_stamps_restart_once_although_the_detector_is_silent_since() -> None:
    bench = started()
    bench.add_image(10 * S, 0.0)
    bench.detect(10 * S, 0.01)
    for n in range(20):  # within the wait for the first detections
        bench.add_image(2 + n * 33 * MS, 0.02 + n * 0.01)
        bench.poll(0.02 + n * 0.01)
    assert bench.counts['times that stamps went back'] == 1
    assert bench.filter.num_resets == 1
    before = len(bench.published)
    for n in range(20, 120):
        bench.add_image(2 + n * 33 * MS, n * 0.033)
    assert len(bench.published) - before >= 90


def test_a_strategy_without_detections_starts_anew_when_the_stamps_restart() -> None:
    bench = Bench(FakeFilter(needs_detections=False, senses_motion=True))
    bench.add_image(10 * S, 0.1)
    assert bench.filter.num_resets == 0
    assert bench.add_image(2, 0.2) == [((2, None), True)]
    assert bench.filter.num_resets == 1


def test_detections_that_come_first_are_final() -> None:
    bench = Bench()
    assert bench.detect(10, 0.0) == []
    assert bench.add_image(10, 0.01) == [((10, 10), False)]
    assert bench.poll(9.0) == []


def test_detections_of_a_later_image_answer_the_skipped_one() -> None:
    bench = started()
    for i in (1, 2, 3):
        bench.add_image(10 * i, 0.03 * i)
    assert bench.detect(20, 0.1) == [(10, 20), (20, 20)]
    assert bench.num_without_detections == 1
    assert bench.detect(30, 0.12) == [(30, 30)]


def test_the_wait_has_a_limit_and_late_detections_go_to_the_next_image() -> None:
    bench = started(wait_s=0.1)
    bench.add_image(10, 0.0)
    assert bench.poll(0.09) == []
    assert bench.poll(0.1) == [(10, None)]
    assert bench.num_without_detections == 1
    assert bench.detect(10, 0.15) == []
    assert bench.add_image(20, 0.16) == [((20, 10), True)]
    assert bench.add_image(30, 0.19) == [((30, None), True)]


def test_no_image_waits_for_a_lost_detector_until_it_answers() -> None:
    bench = started(timeout_s=1.0, wait_s=10.0)
    for i in range(1, 13):
        ((_, is_provisional),) = bench.add_image(i * 100 * MS, 0.1 * i)
        assert is_provisional == (i < 11)
    assert 'no detections for 1.2 s' in bench.problems['detector lost']
    assert len(bench.poll(1.21)) == 10
    assert bench.num_without_detections == 12
    bench.detect(1_300 * MS, 1.31)
    assert bench.problems == {}
    assert bench.add_image(1_400 * MS, 1.4) == [((1_400 * MS, 1_300 * MS), True)]


def test_a_pause_between_images_is_no_loss() -> None:
    bench = started(timeout_s=1.0)
    bench.add_image(10, 0.0)
    bench.detect(10, 0.01)
    bench.add_image(20, 60.0)
    assert bench.problems == {}


def test_nothing_is_published_without_a_detector_where_that_is_configured() -> None:
    bench = started(timeout_s=1.0, on_loss=STOP)
    assert bench.add_image(10, 0.0) != []
    assert bench.add_image(20, 1.5) == []
    assert 'nothing is published' in bench.problems['detector lost']
    bench.detect(30, 2.0)
    assert bench.add_image(30, 2.0) == [((30, 30), False)]


def test_detections_far_ahead_of_the_images_are_refused() -> None:
    bench = started()
    bench.add_image(10 * S, 0.0)
    with pytest.raises(MessageError, match=r'detections are 3600.0 s ahead of the newest image'):
        bench.detect(3610 * S, 0.01)
    assert bench.detect(10 * S, 0.02) == [(10 * S, 10 * S)]


def test_detections_somewhat_ahead_are_kept_for_their_image() -> None:
    bench = started()
    bench.add_image(10 * S, 0.0)
    ahead_ns = 10 * S + 66 * MS
    assert bench.detect(ahead_ns, 0.01) == [(10 * S, ahead_ns)]
    skipped_ns = 10 * S + 33 * MS
    assert bench.add_image(skipped_ns, 0.03) == [((skipped_ns, None), False)]
    assert bench.add_image(ahead_ns, 0.06) == [((ahead_ns, ahead_ns), False)]
    bench.poll(0.07)
    assert bench.num_without_detections == 2


def test_after_a_pause_detections_may_come_before_their_image() -> None:
    bench = started()
    bench.add_image(10 * S, 0.0)
    bench.detect(10 * S, 0.01)
    assert bench.detect(70 * S, 60.0) == []
    assert bench.add_image(70 * S, 60.01) == [((70 * S, 70 * S), False)]


def test_stamps_may_start_anew() -> None:
    bench = started()
    bench.add_image(60 * S, 0.0)
    bench.detect(60 * S + 33 * MS, 0.01)
    bench.add_image(60 * S + 66 * MS, 0.06)  # awaits detections, and is forgotten
    assert bench.detect(10 * S, 0.07) == []  # they come before their image
    assert bench.add_image(10 * S, 0.08) == [((10 * S, 10 * S), False)]
    assert bench.counts['times that stamps went back'] == 1
    next_ns = 10 * S + 33 * MS
    assert bench.add_image(next_ns, 0.1) == [((next_ns, None), True)]
    with pytest.raises(MessageError, match='ahead'):  # late, of the stream before
        bench.detect(60 * S + 66 * MS, 0.11)
    assert bench.detect(next_ns, 0.12) == [(next_ns, next_ns)]


@pytest.mark.parametrize('back_ns', [0, 5 * MS, 999 * MS])
def test_stamps_that_go_back_a_little_start_nothing_anew(back_ns: int) -> None:
    bench = started()
    bench.add_image(10 * S, 0.0)
    bench.add_image(10 * S - back_ns, 0.1)
    assert 'times that stamps went back' not in bench.counts


def test_motion_is_segmented_when_no_image_follows_at_once() -> None:
    bench = Bench(FakeFilter(needs_detections=False, senses_motion=True))
    bench.live.add_image(None, frame_at(10))
    bench.live.on_idle()  # in the same turn: the next image may be there already
    assert bench.filter.motion_ns == []
    assert bench.final == []
    assert bench.num_idle_requests == 2
    bench.live.on_idle()
    assert bench.filter.motion_ns == [10]
    assert (bench.published, bench.final) == ([((10, None), True)], [(10, None)])


def test_an_overtaken_image_goes_without_motion_but_not_more_than_three_in_a_row() -> None:
    bench = Bench(FakeFilter(needs_detections=False, senses_motion=True))
    for i in range(9):
        bench.live.add_image(None, frame_at(i))
    assert bench.filter.motion_ns == [3, 7]
    assert bench.final == [(i, None) for i in range(8)]
    assert bench.counts['images without motion segmentation'] == 6


def test_motion_is_segmented_before_a_final_verdict_by_detections() -> None:
    bench = Bench(FakeFilter(senses_motion=True))
    bench.detect(10, 0.0)
    bench.live.add_image(None, frame_at(10))
    assert bench.published == [((10, 10), True)]
    bench.live.add_image(None, frame_at(20))
    bench.detect(20, 0.1)
    assert bench.filter.motion_ns == [20]
    assert bench.final == [(10, 10), (20, 20)]


def test_forgetting_drops_all_images() -> None:
    bench = started()
    bench.add_image(10, 0.0)
    bench.live.forget()
    assert bench.filter.num_resets == 1
    assert bench.detect(10, 0.1) == []
    assert bench.add_image(20, 0.2) == [((20, 10), True)]
