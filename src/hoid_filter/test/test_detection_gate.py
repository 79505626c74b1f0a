import pytest

from hoid_common.values import Detections
from hoid_filter.detection_gate import LATEST, STOP, DetectionGate, GateConfig, Ready

MS = 1_000_000


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
