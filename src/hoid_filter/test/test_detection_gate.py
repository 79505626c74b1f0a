import pytest

from hoid_common.errors import MessageError
from hoid_common.values import Detections
from hoid_filter.detections.detection_gate import (
    STOP,
    Answered,
    DetectionGate,
    GateConfig,
    Known,
)

MS = 1_000_000
S = 1_000_000_000


def make_gate(**values: object) -> DetectionGate[str]:
    return DetectionGate(GateConfig().updated(values))


def add(gate: DetectionGate[str], stamp_ns: int, item: str, now_s: float) -> tuple[object, bool]:
    """Add an image as the node does; return the stamp of its detections, and if that is final."""
    known = gate.add_image(stamp_ns, now_s)
    if not known.is_final:
        gate.remember(stamp_ns, item, now_s)
    return stamp_of(known), known.is_final


def stamp_of(judged: Known | Answered[str]) -> int | None:
    return None if judged.detections is None else judged.detections.stamp_ns


def stamps(answered: list[Answered[str]]) -> list[tuple[str, int | None]]:
    return [(each.item, stamp_of(each)) for each in answered]


def test_an_image_goes_at_once_and_is_answered_by_its_own_detections() -> None:
    gate = make_gate()
    assert add(gate, 10, 'a', 0.0) == (None, False)
    assert stamps(gate.add_detections(Detections.none(10), 0.05)) == [('a', 10)]
    assert gate.num_unanswered == 0
    assert add(gate, 20, 'b', 0.06) == (None, False)  # it was said already


def test_before_the_first_answer_nothing_is_known_to_predict_from() -> None:
    gate = make_gate(timeout_s=1.0)
    add(gate, 10 * S, 'a', 0.0)
    assert gate.is_blind
    gate.add_detections(Detections.none(10 * S), 0.05)
    assert not gate.is_blind
    assert gate.restart_if_back(1)
    assert gate.is_blind
    add(gate, 1, 'b', 1.0)
    add(gate, 2, 'c', 3.0)
    assert gate.is_lost
    assert not gate.is_blind  # who does not answer at all is not waited for


def test_detections_that_come_first_are_final() -> None:
    gate = make_gate()
    assert gate.add_detections(Detections.none(10), 0.0) == []
    assert add(gate, 10, 'a', 0.01) == (10, True)
    assert gate.poll(9.0) == []


def test_an_answer_to_a_later_image_answers_the_skipped_one() -> None:
    gate = make_gate()
    add(gate, 10, 'a', 0.0)
    add(gate, 20, 'b', 0.03)
    add(gate, 30, 'c', 0.06)
    assert stamps(gate.add_detections(Detections.none(20), 0.07)) == [('a', 20), ('b', 20)]
    assert gate.num_unanswered == 1
    assert stamps(gate.add_detections(Detections.none(30), 0.09)) == [('c', 30)]


def test_the_wait_has_a_limit_and_late_detections_go_to_the_next_image() -> None:
    gate = make_gate(wait_s=0.1)
    add(gate, 10, 'a', 0.0)
    assert gate.poll(0.09) == []
    assert stamps(gate.poll(0.1)) == [('a', None)]
    assert gate.num_unanswered == 1
    assert gate.add_detections(Detections.none(10), 0.15) == []
    assert add(gate, 20, 'b', 0.16) == (10, False)
    assert add(gate, 30, 'c', 0.19) == (None, False)  # each is given once


def test_a_lost_detector_is_not_waited_for_until_it_answers() -> None:
    gate = make_gate(timeout_s=1.0, wait_s=10.0)
    for i in range(12):
        _, is_final = add(gate, i * 100 * MS, str(i), 0.1 * i)
        assert gate.is_lost == is_final == (i > 10)
    assert gate.silent_s == pytest.approx(1.1)
    assert len(gate.poll(1.11)) == 11
    assert gate.num_unanswered == 12
    gate.add_detections(Detections.none(1_200 * MS), 1.21)
    assert not gate.is_lost
    assert add(gate, 1_300 * MS, 'y', 1.3) == (1_200 * MS, False)


def test_a_pause_between_images_is_no_loss() -> None:
    gate = make_gate(timeout_s=1.0)
    add(gate, 10, 'a', 0.0)
    gate.add_detections(Detections.none(10), 0.01)
    add(gate, 20, 'b', 60.0)
    assert not gate.is_lost


def test_without_a_detector_nothing_is_published_where_that_was_asked_for() -> None:
    gate = make_gate(timeout_s=1.0, on_loss=STOP)
    add(gate, 10, 'a', 0.0)
    assert not gate.is_shut
    add(gate, 20, 'b', 1.5)
    assert gate.is_shut
    gate.add_detections(Detections.none(30), 2.0)
    assert add(gate, 30, 'c', 2.0) == (30, True)
    assert not gate.is_shut


def test_detections_far_ahead_of_the_images_are_refused() -> None:
    gate = make_gate()
    add(gate, 10 * S, 'a', 0.0)
    with pytest.raises(MessageError, match=r'detections are 3600.0 s ahead of the newest image'):
        gate.add_detections(Detections.none(3610 * S), 0.01)
    assert stamps(gate.add_detections(Detections.none(10 * S), 0.02)) == [('a', 10 * S)]


def test_detections_somewhat_ahead_are_kept_for_their_image() -> None:
    gate = make_gate()
    add(gate, 10 * S, 'a', 0.0)
    ahead = Detections.none(10 * S + 66 * MS)
    assert stamps(gate.add_detections(ahead, 0.01)) == [('a', 10 * S + 66 * MS)]
    assert add(gate, 10 * S + 33 * MS, 'b', 0.03) == (None, True)  # the detector skipped it
    assert gate.num_unanswered == 2
    assert add(gate, 10 * S + 66 * MS, 'c', 0.06) == (10 * S + 66 * MS, True)


def test_after_a_pause_detections_may_come_before_their_image() -> None:
    gate = make_gate()
    add(gate, 10 * S, 'a', 0.0)
    gate.add_detections(Detections.none(10 * S), 0.01)
    assert gate.add_detections(Detections.none(70 * S), 60.0) == []
    assert add(gate, 70 * S, 'b', 60.01) == (70 * S, True)


def test_time_may_start_anew() -> None:
    gate = make_gate()
    add(gate, 60 * S, 'a', 0.0)
    gate.add_detections(Detections.none(60 * S + 33 * MS), 0.01)
    add(gate, 60 * S + 66 * MS, 'waits', 0.06)
    assert gate.add_detections(Detections.none(10 * S), 0.07) == []  # before their image
    assert gate.restart_if_back(10 * S)
    assert add(gate, 10 * S, 'b', 0.08) == (10 * S, True)
    assert not gate.restart_if_back(10 * S + 33 * MS)
    assert add(gate, 10 * S + 33 * MS, 'c', 0.1) == (None, False)
    with pytest.raises(MessageError, match='ahead'):  # from before, and late
        gate.add_detections(Detections.none(60 * S + 66 * MS), 0.11)
    assert stamps(gate.add_detections(Detections.none(10 * S + 33 * MS), 0.12)) == [
        ('c', 10 * S + 33 * MS)
    ]


@pytest.mark.parametrize('back_ns', [0, 5 * MS, 999 * MS])
def test_a_little_back_is_no_new_start(back_ns: int) -> None:
    gate = make_gate()
    assert not gate.restart_if_back(10 * S)
    add(gate, 10 * S, 'a', 0.0)
    assert not gate.restart_if_back(10 * S - back_ns)
