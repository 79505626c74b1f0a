"""Tracks of people and objects against motions that are known."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import DynamicObject, Reason
from rgbd_slam.object_tracker import ObjectState, ObjectTracker, ObjectTrackerConfig

CONFIG = ObjectTrackerConfig(person_depth_m=0.0)
SECOND_NS = 10**9


def seen(class_name, position, reason):
    return DynamicObject(
        class_name, (0, 0, 1, 1), 0.9, -1, reason, center_camera_m=tuple(position)
    )


def follow(tracker, frames, T=None, rate_hz=30.0, start_s=0.0):
    out = ()
    for i, objects in enumerate(frames):
        stamp_ns = round((start_s + i / rate_hz) * SECOND_NS)
        out = tracker.update(objects, np.eye(4) if T is None else T, stamp_ns)
    return out


def test_a_walking_person_has_position_and_velocity_in_the_map():
    T = se3.exp(np.array([0.1, 0.4, -0.2, 1.0, 2.0, 3.0]))
    frames = [[seen('person', (0.04 * i - 1, 0, 3), Reason.PERSON)] for i in range(45)]
    (track,) = follow(ObjectTracker(CONFIG), frames, T)
    assert track.state is ObjectState.PERSON
    expected = se3.transform(T, np.array([[0.04 * 44 - 1, 0, 3]]))[0]
    np.testing.assert_allclose(track.position_map_m, expected, atol=0.02)
    np.testing.assert_allclose(track.velocity_map_mps, T[:3, 0] * 1.2, atol=0.1)


def test_a_missed_person_is_predicted_then_forgotten():
    tracker = ObjectTracker(CONFIG)
    follow(tracker, [[seen('person', (0.04 * i, 0, 3), Reason.PERSON)] for i in range(45)])
    (track,) = follow(tracker, [[]] * 15, start_s=1.5)
    assert track.position_map_m[0] == pytest.approx(0.04 * 59, abs=0.15)
    assert follow(tracker, [[]], start_s=4.0) == ()


def test_a_carried_object_gets_its_new_place():
    tracker = ObjectTracker(CONFIG)
    rest = [[seen('cup', (0, 0, 2), Reason.STATIC)]] * 10
    (track,) = follow(tracker, rest)
    assert track.state is ObjectState.AT_REST
    carried = [[seen('cup', (0.03 * i, 0, 2), Reason.HANDLED)] for i in range(30)]
    (track,) = follow(tracker, carried, start_s=1.0)
    assert track.state is ObjectState.HANDLED
    put_down = [[seen('cup', (0.9, 0, 2), Reason.STATIC)]] * 30
    (moved,) = follow(tracker, put_down, start_s=2.0)
    assert moved.state is ObjectState.MOVED
    assert moved.track_id == track.track_id
    np.testing.assert_allclose(moved.position_map_m, (0.9, 0, 2), atol=0.03)
    np.testing.assert_allclose(moved.velocity_map_mps, 0)


def test_an_object_lifted_and_put_back_is_at_rest():
    tracker = ObjectTracker(CONFIG)
    follow(tracker, [[seen('cup', (0, 0, 2), Reason.STATIC)]] * 10)
    follow(tracker, [[seen('cup', (0, 0.02, 2), Reason.HANDLED)]] * 30, start_s=1.0)
    (track,) = follow(tracker, [[seen('cup', (0, 0, 2), Reason.STATIC)]] * 30, start_s=2.0)
    assert track.state is ObjectState.AT_REST


def test_two_people_keep_their_ids_and_a_blip_is_not_published():
    tracker = ObjectTracker(CONFIG)
    frames = [
        [
            seen('person', (-1 + 0.01 * i, 0, 2), Reason.PERSON),
            seen('person', (1, 0, 3), Reason.PERSON),
        ]
        for i in range(20)
    ]
    first = follow(tracker, frames[:10])
    blip = [[*frames[10], seen('person', (0, 0, 9), Reason.PERSON)]]
    second = follow(tracker, blip + frames[11:], start_s=0.34)
    assert {t.track_id for t in first} == {t.track_id for t in second}
    assert len(second) == 2


def test_objects_without_depth_are_left_out():
    tracker = ObjectTracker(CONFIG)
    assert follow(tracker, [[seen('cup', (np.nan,) * 3, Reason.STATIC)]] * 5) == ()


def test_memory_is_bounded():
    tracker = ObjectTracker(ObjectTrackerConfig(max_objects=5, min_sightings=1))
    crowd = [[seen('cup', (i, 0, 2), Reason.STATIC) for i in range(20)]]
    assert len(follow(tracker, crowd)) == 5
