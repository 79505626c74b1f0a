"""Relocalization near a given pose."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.slam_status import SlamMode, SlamState
from hoid_common.values import FloatArray
from rgbd_slam.config.place_config import PlaceConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.places.place_finder import FoundPlace, PlaceFinder
from rgbd_slam.places.pose_hint import PoseHint
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession

from .ring_world import CAMERA as RING_CAMERA
from .ring_world import RingWorld, mapped, ring_poses
from .world import CAMERA, PERIOD_NS, World, sway

T_NEXT_DOOR = se3.exp(np.array([0.0, 0, 0, 20.0, 0, 0]))
AWAY = se3.exp(np.array([0.0, 0.2, 0, 0.9, 0, 0.4]))  # of a hint: 1 m and 11 degrees


class TwoRooms:
    """Two identical rooms, 20 m apart in one map."""

    def __init__(self) -> None:
        self.world, self.poses = RingWorld(), ring_poses(12, 0.5)
        self.atlas = Atlas(1.2, 8)
        mapped(self.atlas, self.world, self.poses, self.poses)
        mapped(self.atlas, self.world, self.poses, T_NEXT_DOOR @ self.poses)
        self.finder = PlaceFinder(self.atlas, RING_CAMERA, PlaceConfig(), seed=0)

    def locate(self, hint: PoseHint | None) -> FoundPlace | None:
        """Relocalize a view between two keyframes."""
        frame, _ = self.world.frame(self.between, 10**12)
        return self.finder.locate_near(frame, hint) if hint else self.finder.locate(frame)

    @property
    def between(self) -> FloatArray:
        step = se3.log(se3.inverse(self.poses[5]) @ self.poses[6])
        return np.asarray(self.poses[5] @ se3.exp(step / 2))


@pytest.fixture(scope='module')
def rooms() -> TwoRooms:
    return TwoRooms()


@pytest.mark.parametrize('T_map_room', [np.eye(4), T_NEXT_DOOR], ids=['here', 'next door'])
@pytest.mark.parametrize('off', [np.eye(4), AWAY], ids=['exactly', 'about'])
def test_of_two_identical_rooms_the_hinted_one_is_found(
    rooms: TwoRooms, T_map_room: FloatArray, off: FloatArray
) -> None:
    assert rooms.locate(None) is None  # neither is accepted
    T_map_camera = T_map_room @ rooms.between
    place = rooms.locate(PoseHint(T_map_camera @ off))
    assert place is not None
    np.testing.assert_allclose(place.match.T_map_camera, T_map_camera, atol=0.01)


def test_an_exact_pose_needs_no_place_recognition(
    rooms: TwoRooms, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rooms.finder, 'candidates', lambda *_: [])
    assert rooms.locate(PoseHint(rooms.between)) is not None
    assert rooms.locate(PoseHint(rooms.between @ AWAY)) is None


@pytest.mark.parametrize('twist', [[0.0, 0, 0, 3, 0, 0], [0, 2.0, 0, 0, 0, 0]])
def test_nothing_is_found_out_of_reach(rooms: TwoRooms, twist: list[float]) -> None:
    assert rooms.locate(PoseHint(rooms.between @ se3.exp(np.array(twist)))) is None


def test_a_larger_uncertainty_reaches_further(rooms: TwoRooms) -> None:
    away = PoseHint(rooms.between @ se3.exp(np.array([0.0, 0, 0, 3, 0, 0])), sigma_m=1.2)
    place = rooms.locate(away)
    assert place is not None
    np.testing.assert_allclose(place.match.T_map_camera, rooms.between, atol=0.01)


@pytest.fixture
def session() -> SlamSession:
    """A session that localizes in its own map, tracked up to image 30."""
    session, world = SlamSession(CAMERA, SlamConfig(), RobotFrames()), World()
    for n, T in enumerate(sway(90)):
        session.process(world.features(n * PERIOD_NS, T))
    session.set_mode(SlamMode.LOCALIZATION)
    return session


def given(T_core_camera: FloatArray) -> FloatArray:
    """Return the pose as set in RViz (x forward) for a camera pose in the map."""
    return np.asarray(T_BODY_OPTICAL @ T_core_camera @ se3.inverse(T_BODY_OPTICAL))


def test_a_session_reports_the_distance_from_the_initial_pose(session: SlamSession) -> None:
    pose = sway(90)[20]
    off = se3.exp(np.array([0.0, 0.1, 0, 0.3, 0, 0]))
    session.relocalize_near(given(pose @ off), 0.5, 0.26)
    done = session.process(World().features(100 * PERIOD_NS, pose))
    assert done.status.message == 'found 0.3 m and 6 degrees from the pose given'
    assert done.pose is not None
    T_map_camera = done.pose.T_map_odom @ done.pose.T_odom_base
    np.testing.assert_allclose(T_map_camera, T_BODY_OPTICAL @ pose, atol=0.02)
    assert session.process(World().features(101 * PERIOD_NS, pose)).status.message == ''


def test_a_wrong_initial_pose_is_reported_and_then_ignored(session: SlamSession) -> None:
    pose, elsewhere = sway(90)[20], World(seed=7)
    far = np.array(pose)
    far[2, 3] -= 5.0
    session.relocalize_near(given(far), 0.5, 0.26)
    lost = session.process(elsewhere.features(100 * PERIOD_NS, pose)).status
    assert lost.state is SlamState.LOST
    assert lost.message == 'not found at the pose given; looking everywhere'
    found = session.process(World().features(101 * PERIOD_NS, pose)).status
    assert found.state is SlamState.TRACKING
    assert found.message == 'found 5.0 m and 0 degrees from the pose given'


def test_an_initial_pose_is_refused_while_mapping(session: SlamSession) -> None:
    session.set_mode(SlamMode.MAPPING)
    with pytest.raises(ConfigError, match='needs the mode localization'):
        session.relocalize_near(np.eye(4), 0.0, 0.0)
