"""Tracks of people and objects in rendered depth images, compared with their true motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import UNKNOWN, CameraModel, DynamicObject, FloatArray, ObjectState
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.grid.floor import Floor
from hoid_scene.tracks.object_sighting import DepthImage, measure
from hoid_scene.tracks.object_track import TrackedObject
from hoid_scene.tracks.object_tracker import ObjectTracker

CAMERA = CameraModel(320, 240, 260.0, 260.0, 159.5, 119.5)
CONFIG = ObjectTrackerConfig()
WALL_M = 6.0
RATE_HZ = 10.0
FLOOR = Floor(np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -1.2], [0, 0, 0, 1]]))


class Thing(NamedTuple):
    """A rectangle that faces the camera, with its center in the body frame [m]."""

    class_name: str
    ahead: float
    left: float
    up: float
    size_m: tuple[float, float] = (0.2, 0.2)  # width, height
    reason: ObjectState = ObjectState.AT_REST


def person(ahead: float, left: float, up: float = -0.35, height: float = 1.7) -> Thing:
    return Thing('person', ahead, left, up, (0.5, height), ObjectState.PERSON)


class World:
    """Renders rectangles into depth images, with their boxes as detections."""

    def __init__(self, T_map_body: FloatArray | None = None) -> None:
        self.T_map_camera = (np.eye(4) if T_map_body is None else T_map_body) @ T_BODY_OPTICAL
        self.stamp_ns = 0
        self.tracker = ObjectTracker(CONFIG)
        self.states: dict[str, ObjectState] = {}  # of the last image, by class

    def show(self, *things: Thing, floor: Floor | None = None) -> tuple[TrackedObject, ...]:
        depth = np.full((240, 320), WALL_M, np.float32)
        detections = []
        for class_name, ahead, left, up, (width, height), reason in sorted(
            things, key=lambda t: -t.ahead
        ):
            u, v = 159.5 - 260 * left / ahead, 119.5 - 260 * up / ahead
            du, dv = 130 * width / ahead, 130 * height / ahead
            box = np.clip([u - du, v - dv, u + du, v + dv], 0, [320, 240, 320, 240])
            x1, y1, x2, y2 = np.rint(box).astype(int).tolist()
            depth[y1:y2, x1:x2] = ahead
            left_px, top_px, right_px, bottom_px = box.tolist()
            box_px = (left_px, top_px, right_px, bottom_px)
            detections.append(DynamicObject(class_name, box_px, 0.9, -1, reason))
        image = DepthImage.of(CAMERA, depth, self.T_map_camera)
        out = self.tracker.update(detections, image, self.stamp_ns, floor)
        judged = self.tracker.judged(detections, image, self.stamp_ns)
        self.states = {item.class_name: item.state for item in judged}
        self.stamp_ns += round(1e9 / RATE_HZ)
        return out


def test_a_walking_person_has_position_and_velocity_in_the_map() -> None:
    T = se3.exp(np.array([0, 0, 0.4, 1.0, 2.0, 0.3]))
    world = World(T)
    for i in range(20):
        tracks = world.show(person(3.0, 0.12 * i - 1))
    (track,) = tracks
    assert track.state is ObjectState.PERSON
    expected = se3.transform(T, np.array([[3.0, 0.12 * 19 - 1, -0.35]]))[0]
    np.testing.assert_allclose(track.position_map_m, expected, atol=0.15)
    np.testing.assert_allclose(track.velocity_map_mps, T[:3, 1] * 1.2, atol=0.2)


def test_a_person_whose_legs_are_hidden_stands_on_the_floor() -> None:
    world = World()
    for _ in range(5):
        tracks = world.show(person(3.0, 0, up=0.15, height=0.7), floor=FLOOR)
    (track,) = tracks
    assert track.position_map_m[2] == pytest.approx((0.5 - 1.2) / 2, abs=0.03)
    assert track.size_m[2] == pytest.approx(1.7, abs=0.05)


def test_a_missed_person_is_predicted_then_forgotten() -> None:
    world = World()
    for i in range(15):
        world.show(person(3.0, 0.1 * i - 1))
    for _ in range(5):
        (track,) = world.show()
    assert track.position_map_m[1] == pytest.approx(0.4 + 0.32, abs=0.1)
    for _ in range(10):
        tracks = world.show()
    assert tracks == ()


def test_a_carried_object_gets_its_new_place_and_keeps_its_id() -> None:
    world = World()
    for _ in range(10):
        tracks = world.show(Thing('cup', 2.0, 0.8, 0))
    (rest,) = tracks
    assert rest.state is ObjectState.AT_REST
    for i in range(16):
        left = 0.8 - 0.1 * i
        tracks = world.show(
            person(2.2, left), Thing('cup', 2.0, left, 0, reason=ObjectState.HANDLED)
        )
    carried = next(track for track in tracks if track.class_name == 'cup')
    assert carried.state is ObjectState.HANDLED
    assert carried.velocity_map_mps[1] == pytest.approx(-1.0, abs=0.2)
    for _ in range(15):
        tracks = world.show(Thing('cup', 2.0, -0.7, 0))
    (moved,) = tracks
    assert moved.state is ObjectState.MOVED
    assert moved.track_id == rest.track_id
    np.testing.assert_allclose(moved.position_map_m[1:], (-0.7, 0), atol=0.03)
    np.testing.assert_allclose(moved.velocity_map_mps, 0)


def test_what_moves_undetected_is_tracked_and_forgotten_where_it_rests() -> None:
    world = World()
    for i in range(16):
        tracks = world.show(Thing(UNKNOWN, 2.0, 0.8 - 0.1 * i, 0, (0.3, 0.5), ObjectState.MOVING))
    (track,) = tracks
    assert (track.class_name, track.state) == (UNKNOWN, ObjectState.MOVING)
    np.testing.assert_allclose(track.position_map_m[1:], (-0.7, 0), atol=0.05)
    np.testing.assert_allclose(track.velocity_map_mps, (0, -1, 0), atol=0.2)
    for _ in range(12):  # no detection says that it moves
        tracks = world.show()
    assert tracks == ()


def test_an_object_put_down_after_it_was_out_of_sight_keeps_its_track() -> None:
    world = World()
    for _ in range(10):
        tracks = world.show(Thing('cup', 2.0, 0.8, 0))
    (rest,) = tracks
    for i in range(20):
        world.show(person(2.2, 0.8 - 0.1 * i))  # carries the cup behind the back
    for _ in range(15):
        tracks = world.show(Thing('cup', 2.0, -0.6, 0))
    (moved,) = tracks
    assert (moved.track_id, moved.state) == (rest.track_id, ObjectState.MOVED)


def test_an_object_in_hands_far_from_where_it_was_hidden_keeps_its_id() -> None:
    world = World()
    cup, twin = Thing('cup', 2.0, 0.8, 0), Thing('cup', 2.0, -0.2, 0)
    for _ in range(10):
        tracks = world.show(cup, twin)
    numbers = {round(t.position_map_m[1], 1): t.track_id for t in tracks}
    for _ in range(6):
        world.show(person(1.4, 0.8), twin)  # stands before the cup, whose box is gone
    for i in range(4):
        left = 0.0 + 0.05 * i  # near the twin, which stays where it is
        held = Thing('cup', 1.9, left, 0.3, reason=ObjectState.HANDLED)
        tracks = world.show(person(2.0, left), held, twin, person(1.4, 0.8))
    cups = {t.track_id: t for t in tracks if t.class_name == 'cup'}
    assert cups.keys() == set(numbers.values())
    assert cups[numbers[0.8]].state is ObjectState.HANDLED
    assert cups[numbers[-0.2]].state is ObjectState.AT_REST


def test_a_predicted_box_neither_makes_nor_moves_an_object() -> None:
    world = World()
    for _ in range(10):
        tracks = world.show(Thing('cup', 2.0, 0.8, 0))
    (rest,) = tracks
    for i in range(20):
        left = 0.7 - 0.1 * i
        predicted = Thing('cup', 3.0, left, 0.2, reason=ObjectState.PREDICTED)
        tracks = world.show(person(2.2, left), predicted, Thing('cup', 2.0, 0.8, 0))
    (cup,) = [track for track in tracks if track.class_name == 'cup']
    assert (cup.track_id, cup.state) == (rest.track_id, ObjectState.AT_REST)
    np.testing.assert_allclose(cup.position_map_m, rest.position_map_m, atol=0.02)


def carried_cup(world: World) -> None:
    for _ in range(10):
        world.show(Thing('cup', 2.0, 0.8, 0))
    for i in range(16):
        left = 0.8 - 0.1 * i
        world.show(person(2.2, left), Thing('cup', 2.0, left, 0, reason=ObjectState.HANDLED))


def test_an_object_that_a_person_holds_still_is_handled() -> None:
    """Although the filter calls it static."""
    world = World()
    carried_cup(world)
    for _ in range(4):
        world.show(person(2.2, -0.7), Thing('cup', 2.0, -0.7, 0))
    assert world.states['cup'] is ObjectState.HANDLED
    assert world.states['person'] is ObjectState.PERSON


def test_an_object_that_nobody_is_near_any_more_is_at_rest() -> None:
    """Although its track is still handled."""
    world = World()
    carried_cup(world)
    for _ in range(6):
        tracks = world.show(Thing('cup', 2.0, -0.7, 0))
    assert [t.state for t in tracks if t.class_name == 'cup'] == [ObjectState.HANDLED]
    assert world.states['cup'] is ObjectState.AT_REST


def test_an_object_that_was_put_down_beside_a_person_is_at_rest() -> None:
    """Although the filter calls it handled."""
    world = World()
    carried_cup(world)
    put_down = Thing('cup', 2.0, -0.7, 0, reason=ObjectState.HANDLED)
    for _ in range(15):
        world.show(person(2.2, -0.7), put_down)
    assert world.states['cup'] is ObjectState.MOVED


def test_a_box_behind_a_person_is_not_handled() -> None:
    world = World()
    tv = Thing('tv', 5.0, 0, 0, size_m=(0.8, 0.8))
    for _ in range(10):
        tracks = world.show(tv)
    (rest,) = tracks
    overlapped = Thing('tv', 5.0, 0, 0, size_m=(0.8, 0.8), reason=ObjectState.HANDLED)
    for i in range(20):
        tracks = world.show(overlapped, person(2.0, 1.0 - 0.1 * i))
    (track,) = [track for track in tracks if track.class_name == 'tv']
    assert track.state is ObjectState.AT_REST
    assert world.states['tv'] is ObjectState.AT_REST
    np.testing.assert_allclose(track.position_map_m, rest.position_map_m, atol=0.02)


def test_two_people_keep_their_ids_and_a_blip_is_not_published() -> None:
    world = World()
    for i in range(10):
        first = world.show(person(2.5, -0.8 + 0.03 * i), person(3.5, 1.0))
    world.show(person(2.5, -0.5), person(3.5, 1.0), Thing('cup', 1.5, 0.3, 0))
    second = world.show(person(2.5, -0.45), person(3.5, 1.0))
    assert [t.track_id for t in first] == [t.track_id for t in second]
    assert len(second) == 2


def test_objects_without_depth_are_left_out() -> None:
    depth = np.zeros((240, 320), np.float32)
    image = DepthImage.of(CAMERA, depth, T_BODY_OPTICAL)
    cup = DynamicObject('cup', (100, 100, 150, 150), 0.9, -1, ObjectState.AT_REST)
    assert measure(cup, image, None, None) is None


def test_the_center_of_an_object_is_behind_its_surface() -> None:
    world = World()
    for _ in range(5):
        tracks = world.show(Thing('bottle', 2.0, 0.3, 0.1, size_m=(0.08, 0.3)))
    (track,) = tracks
    np.testing.assert_allclose(track.position_map_m, (2.04, 0.3, 0.1), atol=0.02)
    assert track.size_m[2] == pytest.approx(0.3, abs=0.06)


def test_the_number_of_tracks_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ObjectTrackerConfig, 'max_objects', 5)
    monkeypatch.setattr(ObjectTrackerConfig, 'min_sightings', 1)
    world = World()
    world.tracker = ObjectTracker(ObjectTrackerConfig())
    crowd = [Thing('cup', 4.0, 0.45 * i - 2, 0) for i in range(9)]
    assert len(world.show(*crowd)) == 5
