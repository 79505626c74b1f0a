"""While tracking goes on, a line says so every ten seconds."""

from __future__ import annotations

from typing import Any

import pytest

from hoid_common.slam_status import SlamState, SlamStatus
from rgbd_slam.ros.tracking_log import TrackingLog

STAGE_MS = {'track': 12.4}


class FakeNode:
    """A node that keeps its log lines, which is its own logger."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def get_logger(self) -> FakeNode:
        return self

    def info(self, line: str) -> None:
        self.lines.append(line)


@pytest.fixture
def clock_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The present time, which a test may change."""
    now_s = [100.0]
    monkeypatch.setattr('rgbd_slam.ros.tracking_log.time.monotonic', lambda: now_s[0])
    return now_s


def track(
    log: TrackingLog, clock_s: list[float], states: list[SlamState], period_s: float
) -> None:
    for number, state in enumerate(states, 1):
        clock_s[0] += period_s
        log.update(SlamStatus(state, keyframes=41, frames_processed=number, stage_ms=STAGE_MS))


def test_a_line_every_ten_seconds_says_how_tracking_goes(clock_s: list[float]) -> None:
    node: Any = FakeNode()
    log = TrackingLog(node)
    track(log, clock_s, [SlamState.TRACKING] * 750, 1 / 30)  # 25 s
    assert node.lines == [
        'tracking has begun',
        'tracking, 30.0 Hz, 12 ms, 41 keyframes',
        'tracking, 30.0 Hz, 12 ms, 41 keyframes',
    ]


def test_only_tracked_images_count_and_a_lost_camera_is_silent(clock_s: list[float]) -> None:
    node: Any = FakeNode()
    log = TrackingLog(node)
    track(log, clock_s, [SlamState.TRACKING] * 50 + [SlamState.LOST] * 300, 0.1)
    assert node.lines[2:] == ['tracking, 5.0 Hz, 12 ms, 41 keyframes']


@pytest.mark.usefixtures('clock_s')
def test_a_second_map_waits_for_a_recognized_place() -> None:
    node: Any = FakeNode()
    log = TrackingLog(node)
    for number, maps in enumerate((1, 0, 1, 2), 1):  # the first map was too small to be kept
        state = SlamState.TRACKING if maps else SlamState.LOST
        log.update(SlamStatus(state, maps=maps, frames_processed=number, stage_ms=STAGE_MS))
    assert node.lines[2:] == [
        'a new map was started',
        'a new map was started; 2 maps exist until a recognized place joins them',
    ]
