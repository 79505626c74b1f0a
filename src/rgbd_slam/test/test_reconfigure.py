"""Parameters that change while a session runs."""

from __future__ import annotations

from hoid_common.slam_status import SlamState
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession

from .world import CAMERA, PERIOD_NS, World, sway

POSES = sway(60)


def _keyframes(config: SlamConfig, later: SlamConfig) -> list[int]:
    """Return the numbers of keyframes when the parameters change, halfway, and at the end."""
    session, world, counts = SlamSession(CAMERA, config, RobotFrames()), World(), []
    for n, pose in enumerate(POSES):
        counts.append(session.process(world.features(n * PERIOD_NS, pose)).status.keyframes)
        if n == len(POSES) // 2:
            session.reconfigure(later)
    return [counts[len(POSES) // 2], counts[-1]]


def test_keyframes_are_made_by_the_rules_of_now() -> None:
    config = SlamConfig()
    rarely = config.updated({'keyframes.min_gap_s': 10.0, 'keyframes.fallen_share': 0.0})
    half, whole = _keyframes(config, config)
    held_half, held = _keyframes(config, rarely)
    assert held_half == half
    assert held == half < whole


def test_a_new_map_is_started_as_soon_as_asked_now() -> None:
    session, world = SlamSession(CAMERA, SlamConfig(), RobotFrames()), World()
    for n, pose in enumerate(POSES[:10]):
        session.process(world.features(n * PERIOD_NS, pose))
    config = SlamConfig().updated({'places.new_map_after_s': 0.2})
    session.reconfigure(config)
    elsewhere = World(seed=1)  # nothing of it is known
    states = [
        session.process(elsewhere.features(n * PERIOD_NS, POSES[0])).status for n in range(10, 20)
    ]
    assert states[0].state is SlamState.LOST
    assert states[-1].state is SlamState.TRACKING
    assert states[-1].maps == 2
