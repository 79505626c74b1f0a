import pytest

from hoid_common.errors import MessageError
from hoid_common.values import Detections
from hoid_filter.detections.detection_gate import LATEST, STOP, DetectionGate, GateConfig, Ready

MS = 1_000_000
S = 1_000_000_000


def gate(**values: object) -> DetectionGate[str]:
    return DetectionGate(GateConfig().updated(values))


def stamps(ready: list[Ready[str]]) -> list[tuple[str, int | None]]:
    return [(r.item, None if r.detections is None else r.detections.stamp_ns) for r in ready]


def test_image_waits_for_its_own_detections() -> None:
    exact = gate()
    assert exact.add_image(10, 'a', 0.0) == []
    assert stamps(exact.add_detections(Detections.none(10), 0.05)) == [('a', 10)]


def test_detections_may_come_first() -> None:
    exact = gate()
    assert exact.add_detections(Detections.none(10), 0.0) == []
    assert stamps(exact.add_image(10, 'a', 0.01)) == [('a', 10)]


def test_an_answer_to_a_later_image_frees_the_skipped_one() -> None:
    exact = gate()
    exact.add_image(10, 'a', 0.0)
    exact.add_image(20, 'b', 0.03)
    assert stamps(exact.add_detections(Detections.none(20), 0.05)) == [('a', None), ('b', 20)]
    assert exact.num_unanswered == 1


def test_the_wait_has_a_limit_and_late_detections_go_to_the_next_image() -> None:
    exact = gate(wait_s=0.1)
    exact.add_image(10, 'a', 0.0)
    assert exact.poll(0.09) == []
    assert stamps(exact.poll(0.1)) == [('a', None)]
    exact.add_detections(Detections.none(10), 0.15)
    exact.add_image(20, 'b', 0.16)
    assert stamps(exact.poll(0.27)) == [('b', 10)]


def test_latest_never_waits_and_gives_each_detection_once() -> None:
    latest = gate(mode=LATEST)
    latest.add_detections(Detections.none(5), 0.0)
    assert stamps(latest.add_image(10, 'a', 0.0)) == [('a', 5)]
    assert stamps(latest.add_image(20, 'b', 0.03)) == [('b', None)]


def test_lost_detector_is_not_waited_for_until_it_answers() -> None:
    exact = gate(timeout_s=1.0, wait_s=10.0)
    for i in range(12):
        exact.add_image(i * 100 * MS, str(i), 0.1 * i)
        assert exact.is_lost == (i > 10)
    assert exact.silent_s == pytest.approx(1.1)
    assert stamps(exact.add_image(1_200 * MS, 'x', 1.2)) == [('x', None)]
    exact.add_detections(Detections.none(1_200 * MS), 1.21)
    assert not exact.is_lost
    assert exact.add_image(1_300 * MS, 'y', 1.3) == []


def test_pause_between_images_is_no_loss() -> None:
    exact = gate(timeout_s=1.0)
    exact.add_image(10, 'a', 0.0)
    exact.add_detections(Detections.none(10), 0.01)
    exact.add_image(20, 'b', 60.0)
    assert not exact.is_lost


def test_stop_on_loss_gives_nothing() -> None:
    stopping = gate(timeout_s=1.0, wait_s=0.1, on_loss=STOP)
    stopping.add_image(10, 'a', 0.0)
    assert stamps(stopping.poll(0.1)) == [('a', None)]
    assert stopping.add_image(20, 'b', 1.5) == []
    assert stopping.poll(2.0) == []
    stopping.add_detections(Detections.none(30), 2.0)
    assert stamps(stopping.add_image(30, 'c', 2.0)) == [('c', 30)]


def test_detections_far_ahead_of_the_images_are_refused() -> None:
    exact = gate()
    exact.add_image(10 * S, 'a', 0.0)
    with pytest.raises(MessageError, match=r'detections are 3600.0 s ahead of the newest image'):
        exact.add_detections(Detections.none(3610 * S), 0.01)
    assert stamps(exact.add_detections(Detections.none(10 * S), 0.02)) == [('a', 10 * S)]


def test_detections_somewhat_ahead_hold_no_others_back() -> None:
    exact = gate()
    exact.add_image(10 * S, 'a', 0.0)
    assert stamps(exact.add_detections(Detections.none(10 * S + 900 * MS), 0.01)) == [('a', None)]
    exact.add_image(10 * S + 33 * MS, 'b', 0.03)
    exact.add_detections(Detections.none(10 * S + 33 * MS), 0.04)
    assert stamps(exact.add_image(10 * S + 66 * MS, 'c', 0.2)) == []
    assert stamps(exact.add_detections(Detections.none(10 * S + 66 * MS), 0.2)) == [
        ('c', 10 * S + 66 * MS)
    ]
    assert stamps(exact.add_image(10 * S + 900 * MS, 'd', 0.9)) == [('d', 10 * S + 900 * MS)]


def test_after_a_pause_detections_may_come_before_their_image() -> None:
    exact = gate()
    exact.add_image(10 * S, 'a', 0.0)
    exact.add_detections(Detections.none(10 * S), 0.01)
    assert exact.add_detections(Detections.none(70 * S), 60.0) == []
    assert stamps(exact.add_image(70 * S, 'b', 60.01)) == [('b', 70 * S)]


def test_time_may_start_anew() -> None:
    exact = gate()
    exact.add_image(60 * S, 'a', 0.0)
    exact.add_detections(Detections.none(60 * S + 33 * MS), 0.01)
    exact.add_image(60 * S + 66 * MS, 'waits', 0.06)
    exact.add_detections(Detections.none(10 * S), 0.07)  # before their image
    assert exact.restart_if_back(10 * S)
    assert stamps(exact.add_image(10 * S, 'b', 0.08)) == [('b', 10 * S)]
    assert not exact.restart_if_back(10 * S + 33 * MS)
    assert exact.add_image(10 * S + 33 * MS, 'c', 0.1) == []
    with pytest.raises(MessageError, match='ahead'):  # from before, and late
        exact.add_detections(Detections.none(60 * S + 66 * MS), 0.11)
    assert stamps(exact.add_detections(Detections.none(10 * S + 33 * MS), 0.12)) == [
        ('c', 10 * S + 33 * MS)
    ]


@pytest.mark.parametrize('back_ns', [0, 5 * MS, 999 * MS])
def test_a_little_back_is_no_new_start(back_ns: int) -> None:
    exact = gate()
    assert not exact.restart_if_back(10 * S)
    exact.add_image(10 * S, 'a', 0.0)
    assert not exact.restart_if_back(10 * S - back_ns)
