"""A map grows with the space seen and not with time: the camera follows one path ten times."""

from __future__ import annotations

from typing import NamedTuple

import psutil
import pytest

from hoid_common.slam_status import SlamState
from rgbd_slam.config.slam_config import CameraConfig, SlamConfig
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA, PERIOD_NS, World, sway

POSES = sway(91, turn_rad=3.0, way_m=0.5)[:-1]  # round the room both ways, ending where it began
PASSES = 10
# Largest growth from the third pass to the last: culling follows a few keyframes later.
GROWTH = 1.1


class Size(NamedTuple):
    """The size of a session."""

    keyframes: int
    points: int
    memory: int  # resident bytes of the process

    @classmethod
    def of(cls, slam: RgbdSlam) -> Size:
        stats = slam.stats
        return cls(stats.num_keyframes, stats.num_map_points, psutil.Process().memory_info().rss)


@pytest.mark.slow
@pytest.mark.parametrize(
    'close_baselines',
    [
        40.0,  # most is close
        5.0,  # hardly anything is, as in a hall
    ],
)
def test_what_is_seen_again_adds_nothing(
    close_baselines: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CameraConfig, 'close_baselines', close_baselines)
    world, slam, sizes = World(), RgbdSlam(CAMERA, SlamConfig()), []
    for n in range(PASSES * len(POSES)):
        seen = world.features(n * PERIOD_NS, POSES[n % len(POSES)])
        assert slam.process(seen).state is SlamState.TRACKING
        if (n + 1) % len(POSES) == 0:
            sizes.append(Size.of(slam))
    assert sizes[2].keyframes > 10
    for name, third, last in zip(Size._fields, sizes[2], sizes[-1], strict=True):
        assert last < GROWTH * third, name
