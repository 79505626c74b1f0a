"""A map that is copied in parts, between which it changes."""

from __future__ import annotations

from pathlib import Path

import pytest

from rgbd_slam.map_io import map_parts
from rgbd_slam.map_io.map_collector import MapCollector
from rgbd_slam.model.map_state import snapshot

from .checkpoint_robot import CHANGES, Robot


def test_a_map_that_is_collected_in_parts_is_its_snapshot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(tmp_path)
    monkeypatch.setattr(map_parts, '_MAX_KEYFRAMES', 2)
    monkeypatch.setattr(map_parts, '_MAX_POINTS', 40)
    collector, changes = MapCollector(robot.copy), list(CHANGES.values())
    while (state := collector.add(collector.copy())) is None:
        if changes:
            changes.pop(0)(robot)
    assert not changes
    assert state.digest() == snapshot(robot.copy).digest()
