"""A session tracks images, gives their poses to others, and applies late verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.slam_status import SlamMode, SlamState
from hoid_common.values import BoolArray, FeatureVerdicts
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_state import snapshot
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import Processed, SlamSession

from .world import CAMERA, PERIOD_NS, World, sway

POSES = sway(90)


def new_session(**changes: object) -> SlamSession:
    config = SlamConfig().updated(dict(changes))
    return SlamSession(CAMERA, config, RobotFrames())


def see(session: SlamSession, world: World, n: int, covered: bool = False) -> Processed:
    features = world.features(n * PERIOD_NS, POSES[n], limit=0 if covered else 900)
    return session.process(features)


def test_a_tracked_image_has_a_pose_relative_to_a_keyframe() -> None:
    session, world = new_session(), World()
    done = [see(session, world, n) for n in range(5)]
    for n, each in enumerate(done):
        image = each.image
        assert image is not None
        assert image.stamp_ns == n * PERIOD_NS
        assert image.keyframe_uid in session.map.keyframes().uids
        assert image.is_in_main_map
        assert image.is_growing
    assert session.slam.stats.num_keyframes == len(session.map.copy_poses().stamps_ns)


def test_the_pose_is_known_before_the_image_changes_the_map() -> None:
    session, world = new_session(), World()
    see(session, world, 0)
    for n, T_world_camera in enumerate(POSES[1:40], start=1):
        before = snapshot(session.map.atlas).digest()
        tracked = session.track(world.features(n * PERIOD_NS, T_world_camera))
        assert tracked.pose is not None
        assert snapshot(session.map.atlas).digest() == before
        assert len(session.map.trajectory('online').stamps_ns) == n
        assert session.learn(tracked).pose is tracked.pose
    assert session.slam.stats.num_keyframes > 1


def test_in_localization_the_map_does_not_grow() -> None:
    session, world = new_session(), World()
    see(session, world, 0)
    session.set_mode(SlamMode.LOCALIZATION)
    image = see(session, world, 1).image
    assert image is not None
    assert not image.is_growing
    session.set_mode(SlamMode.MAPPING)
    image = see(session, world, 2).image
    assert image is not None
    assert image.is_growing


def test_a_lost_image_has_no_pose_and_one_beside_the_main_map_is_marked() -> None:
    session, here, there = new_session(**{'places.new_map_after_s': 0.2}), World(), World(seed=7)
    for n in range(20):
        see(session, here, n)
    lost = [see(session, there, n, covered=True) for n in range(20, 24)]
    assert [each.image for each in lost] == [None] * 4
    done = [see(session, there, n) for n in range(24, 40)]
    assert session.slam.stats.num_maps == 2
    assert 'merged' in done[-1].status.message
    image = done[-1].image
    assert image is not None
    assert image.is_growing
    assert not image.is_in_main_map


def test_a_paused_session_ignores_images_and_resumes_where_it_was() -> None:
    session, world = new_session(), World()
    see(session, world, 0)
    session.is_paused = True
    paused = see(session, world, 1)
    assert paused.status.state is SlamState.PAUSED
    assert (paused.pose, paused.image) == (None, None)
    session.is_paused = False
    assert see(session, world, 2).status.state is SlamState.TRACKING
    assert session.map.trajectory('online').stamps_ns.tolist() == [0, 2 * PERIOD_NS]


def test_reading_the_state_of_a_session_changes_nothing() -> None:
    session, world = new_session(), World()
    for n in range(10):
        see(session, world, n)
    atlas = session.map.atlas
    before, version = snapshot(atlas).digest(), atlas.version
    for _ in range(2):
        assert session.map.mapper.is_settled
        assert session.map.is_growing
        assert not session.map.is_empty
        assert session.map.mapper.queue_length == 0
        assert session.map.mapper.num_restarts == 0
        assert session.mode is SlamMode.MAPPING
    assert (snapshot(session.map.atlas).digest(), session.map.atlas.version) == (
        before,
        version,
    )


def first_features(num: int, of: int) -> BoolArray:
    return np.arange(of) < num


def test_features_that_prove_dynamic_are_removed_from_the_map() -> None:
    session, world = new_session(), World()
    features = world.features(0, POSES[0])
    session.process(features)
    before = session.slam.stats.num_map_points
    is_dynamic = first_features(200, len(features))
    num_made = int(np.count_nonzero(features.depth_m[is_dynamic] > 0))
    assert num_made > 50
    session.apply_verdicts(FeatureVerdicts(0, is_dynamic))
    assert session.slam.stats.num_map_points == before - num_made
    session.apply_verdicts(FeatureVerdicts(0, is_dynamic))  # a second verdict on the same keyframe
    assert session.slam.stats.num_map_points == before - num_made
    done = see(session, world, 1)
    assert done.status.state is SlamState.TRACKING
    assert done.status.tracked_points <= before - num_made


def test_verdicts_without_dynamic_features_or_image_change_nothing() -> None:
    session, world = new_session(), World()
    num = len(world.features(0, POSES[0]))
    see(session, world, 0)
    before = session.slam.stats
    session.apply_verdicts(FeatureVerdicts(0, first_features(0, 0)))  # nothing is dynamic
    session.apply_verdicts(FeatureVerdicts(7, first_features(num, num)))  # an image never seen
    assert session.slam.stats == before


def test_verdicts_of_another_length_are_refused() -> None:
    session = new_session()
    see(session, World(), 0)
    with pytest.raises(MessageError, match='feature_verdicts are of 3 features, but the image'):
        session.apply_verdicts(FeatureVerdicts(0, first_features(1, 3)))


def test_a_verdict_that_arrives_before_its_image_removes_its_features() -> None:
    session, world = new_session(), World()
    see(session, world, 0)
    features = world.features(PERIOD_NS, POSES[1])
    session.apply_verdicts(FeatureVerdicts(PERIOD_NS, first_features(300, len(features))))
    others = new_session()
    see(others, World(), 0)
    got = session.process(features)
    wanted = others.process(features.select(np.arange(300, len(features))))
    assert got.status.tracked_points == wanted.status.tracked_points


def test_poses_that_the_mapping_process_has_moved_are_a_change_of_the_map() -> None:
    """A global adjustment that ends after the last keyframe changes no statistics."""
    session, world = new_session(), World()
    for n in range(10):
        see(session, world, n)
    atlas, slam_map = session.map.atlas, session.map
    assert slam_map.consume_change()
    assert not slam_map.consume_change()
    mapper = Atlas(1.2, 8)
    whole = atlas.whole()
    mapper.apply(whole)
    mapper.version += 1
    rows = mapper.keyframes.indices()
    mapper.set_poses(rows, mapper.keyframes.T_map_camera[rows] @ se3.exp(np.full(6, 0.01)))
    stats = session.slam.stats
    atlas.apply(mapper.changes_since(whole.version))
    assert session.slam.stats == stats
    assert slam_map.consume_change()
    assert not slam_map.consume_change()
