"""The object map of rendered boxes, compared with their true places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import DynamicObject, FloatArray, ObjectState
from hoid_scene.objects.mapped_object import MapObject, MappedObject
from hoid_scene.objects.merging import Merging, are_inside_each_other
from hoid_scene.objects.segmentation import Segment
from hoid_scene.objects.voxel_set import trimmed_box
from hoid_scene.place import Anchor, Place
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.tracks.object_track import TrackedObject

from .object_world import LOOK_NS, Box, ObjectWorld, keyframes, rendered

TABLE = Box('', (1.6, -0.8, -1.2), (2.6, 0.8, -0.45))
CUP = Box('cup', (1.9, 0.3, -0.45), (2.0, 0.4, -0.3))
BOOK = Box('book', (1.8, -0.5, -0.45), (2.1, -0.2, -0.4))
BEAR = Box('teddy bear', (1.9, 0.0, -0.45), (2.15, 0.25, -0.1))
PERSON = Box('person', (1.2, -0.2, -1.2), (1.4, 0.3, 0.6), ObjectState.PERSON)


def moved(
    box: Box, by_m: tuple[float, float, float], reason: ObjectState = ObjectState.AT_REST
) -> Box:
    low, high = (np.add(corner, by_m).tolist() for corner in box[1:3])
    return Box(box.class_name, tuple(low), tuple(high), reason)


def at(x_m: float, y_m: float, yaw_rad: float) -> FloatArray:
    T = np.eye(4)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    T[:2, :2], T[:2, 3] = [[c, -s], [s, c]], (x_m, y_m)
    return T


def track(box: Box, state: ObjectState, track_id: int = 7) -> TrackedObject:
    size_m = np.subtract(box.high_m, box.low_m)
    return TrackedObject(
        track_id, box.class_name, state, 0, 0.9, box.center_m, np.zeros(3), size_m
    )


def only(objects: tuple[MapObject, ...], class_name: str) -> MapObject:
    found = [item for item in objects if item.class_name == class_name]
    assert len(found) == 1, [item.class_name for item in objects]
    return found[0]


def test_objects_on_a_table_have_their_own_boxes() -> None:
    objects = ObjectWorld().look(TABLE, CUP, BOOK, times=6)
    assert {item.class_name for item in objects} == {'cup', 'book'}
    for box, tolerance_m in ((CUP, 0.05), (BOOK, 0.06)):
        item = only(objects, box.class_name)
        assert np.linalg.norm(item.center_map_m - box.center_m) < tolerance_m
        assert item.num_sightings == 6
        assert item.state is ObjectState.AT_REST
        assert item.probability > 0.8


def test_people_are_never_in_the_map() -> None:
    cup = moved(CUP, (0.0, 0.3, 0.0))
    objects = ObjectWorld().look(TABLE, PERSON, cup, times=6)
    assert [item.class_name for item in objects] == ['cup']


def test_two_of_a_kind_beside_each_other_stay_two() -> None:
    second = moved(CUP, (0.0, 0.14, 0.0))
    world = ObjectWorld()
    for i in range(8):
        objects = world.look(TABLE, CUP, second, T_map_body=at(0.0, 0.05 * i, 0.0))
    y_m = sorted(item.center_map_m[1] for item in objects)
    assert y_m == pytest.approx([0.35, 0.49], abs=0.03)


def thing(
    class_name: str, low_m: tuple[float, float, float], side_m: float = 0.2, object_id: int = 0
) -> MappedObject:
    """Return a cube that was seen three times."""
    steps = np.moveaxis(np.mgrid[:9, :9, :9], 0, -1).reshape(-1, 3) / 8
    points = np.array(low_m) + side_m * steps
    none, middle = np.empty(0, np.int64), points.mean(axis=0)
    item = MappedObject(object_id, Place.at(middle, Anchor(0, 0, np.eye(4), np.eye(4))), 0)
    seen = DynamicObject(class_name, (0.0, 0.0, 9.0, 9.0), 0.9, -1, ObjectState.AT_REST)
    segment = Segment(
        seen, (0, 0, 9, 9), none, points, middle, points.min(axis=0), points.max(axis=0), none
    )
    for stamp_ns in (0, LOOK_NS, 2 * LOOK_NS):
        item.add(segment, stamp_ns, np.eye(4))
    return item


def test_objects_of_a_class_that_are_inside_each_other_are_one() -> None:
    """Although an image may have shown two boxes of it."""
    plant = thing('potted plant', (2.0, 0.0, 0.0))
    assert are_inside_each_other(plant, thing('potted plant', (2.03, 0.02, 0.05)))
    assert not are_inside_each_other(plant, thing('vase', (2.03, 0.02, 0.05)))
    assert not are_inside_each_other(plant, thing('potted plant', (2.0, 0.13, 0.0)))


def test_a_screen_is_not_the_desk_in_whose_box_it_stands() -> None:
    """Their boxes share most of the screen, and the desk is twice as large."""
    screen = thing('tv', (2.0, 0.0, 0.0), 0.5)
    desk = thing('dining table', (1.8, -0.3, -0.4), 1.0, 1)
    assert Merging().merged([screen, desk]) == [screen, desk]


@pytest.mark.parametrize(('half_width_m', 'count'), [(0.25, 1), (0.45, 2)])
def test_two_sides_of_a_chair_at_the_border_of_the_image_are_one(
    half_width_m: float, count: int
) -> None:
    """Two sides that are too far apart for one chair stay two."""
    chair = Box('chair', (1.9, -half_width_m, -1.2), (2.3, half_width_m, -0.2))
    world, yaw_rad = ObjectWorld(), np.radians(31.4) + np.arctan(0.5 * half_width_m / 1.9)
    world.look(chair, T_map_body=at(0.0, 0.0, yaw_rad), times=5)
    objects = world.look(chair, T_map_body=at(0.0, 0.0, -yaw_rad), times=5)
    assert [item.class_name for item in objects] == ['chair'] * count


def test_what_goes_on_beyond_the_box_is_not_a_part_of_the_object() -> None:
    """A desk beside a chair, in front of a depth edge, that only reaches into its box."""
    chair = Box('chair', (2.0, -0.3, -1.2), (2.3, 0.2, -0.2))
    desk = Box('', (2.1, 0.3, -0.6), (2.2, 1.8, -0.1))
    world = ObjectWorld()
    for _ in range(6):
        depth_m, seen = rendered((chair, desk), T_BODY_OPTICAL)
        ((left, top, right, bottom),) = [item.box_xyxy_px for item in seen]
        wide = replace(seen[0], box_xyxy_px=(left - 90, top, right, bottom))
        world.stamp_ns += LOOK_NS
        request = SceneRequest(world.stamp_ns, T_BODY_OPTICAL, 0, world.keyframes, True, True)
        world.map.update(request, depth_m, [wide])
    item = only(world.map.objects(), 'chair')
    assert item.size_m[1] == pytest.approx(0.5, abs=0.06)


def test_parts_seen_later_complete_an_object() -> None:
    hiding = Box('', (1.5, -0.2, -0.45), (1.6, 0.1, 0.2))  # a screen in front of half of the bear
    world = ObjectWorld()
    first = only(world.look(TABLE, BEAR, hiding, times=5), 'teddy bear')
    whole = only(world.look(TABLE, BEAR, times=8), 'teddy bear')
    assert whole.object_id == first.object_id
    assert first.size_m[1] < 0.2
    assert whole.size_m[1] == pytest.approx(0.25, abs=0.04)
    assert np.linalg.norm(whole.center_map_m - BEAR.center_m) < 0.08


def test_the_surface_of_a_person_in_front_is_not_that_of_the_object() -> None:
    world = ObjectWorld()
    before = only(world.look(TABLE, BEAR, times=5), 'teddy bear')
    after = only(world.look(TABLE, PERSON, BEAR, times=5), 'teddy bear')
    assert np.linalg.norm(after.center_map_m - before.center_map_m) < 0.02


def test_what_was_seen_through_is_gone() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, BOOK, times=5)
    objects = world.look(TABLE, BOOK, times=6)
    assert only(objects, 'cup').state is ObjectState.GONE
    assert only(objects, 'cup').probability < 0.2
    assert only(objects, 'book').state is ObjectState.AT_REST
    back = only(world.look(TABLE, CUP, BOOK, times=3), 'cup')
    assert back.state is ObjectState.AT_REST


def test_a_person_who_hides_an_object_has_not_taken_it() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, times=5)
    wide = Box('person', (1.2, -0.2, -1.2), (1.4, 0.6, 0.6), ObjectState.PERSON)
    item = only(world.look(TABLE, wide, times=10), 'cup')
    assert item.state is ObjectState.AT_REST
    assert item.probability > 0.8


def test_an_object_keeps_its_id_when_a_person_carries_it() -> None:
    world, target = ObjectWorld(), moved(BEAR, (0.2, -0.6, 0.0))
    rest = (track(BEAR, ObjectState.AT_REST),)
    before = only(world.look(TABLE, BEAR, times=6, tracks=rest), 'teddy bear')
    carried = moved(BEAR, (-0.3, -0.4, 0.5), ObjectState.HANDLED)
    holder = moved(PERSON, (0.0, -0.5, 0.0), ObjectState.PERSON)
    tracks = (track(carried, ObjectState.HANDLED), track(holder, ObjectState.PERSON, 9))
    handled = only(world.look(TABLE, holder, carried, times=4, tracks=tracks), 'teddy bear')
    assert handled.state is ObjectState.HANDLED
    assert handled.holder_id == 9
    rest = (track(target, ObjectState.MOVED),)
    after = only(world.look(TABLE, target, times=5, tracks=rest), 'teddy bear')
    assert after.object_id == before.object_id
    assert after.state is ObjectState.MOVED
    assert np.linalg.norm(after.center_map_m - target.center_m) < 0.08
    assert after.moved_from_map_m == pytest.approx(before.center_map_m, abs=0.1)


def test_an_object_whose_track_was_lost_is_found_where_a_person_has_been() -> None:
    world, target = ObjectWorld(), moved(BEAR, (0.2, -0.6, 0.0))
    before = only(world.look(TABLE, BEAR, times=6), 'teddy bear')
    person = track(moved(PERSON, (0.2, -0.6, 0.0)), ObjectState.PERSON, 9)
    gone = only(world.look(TABLE, times=5, tracks=(person,)), 'teddy bear')
    assert gone.state is ObjectState.GONE
    after = only(world.look(TABLE, target, times=4), 'teddy bear')
    assert after.object_id == before.object_id
    assert after.state is ObjectState.MOVED


def test_another_object_of_the_class_is_not_the_one_that_was_taken() -> None:
    world, other = ObjectWorld(), moved(BEAR, (0.2, -0.6, 0.0))
    before = only(world.look(TABLE, BEAR, times=6), 'teddy bear')
    world.look(TABLE, times=5)
    bears = {item.object_id: item.state for item in world.look(TABLE, other, times=4)}
    assert bears[before.object_id] is ObjectState.GONE
    assert sorted(state.name for state in bears.values()) == ['AT_REST', 'GONE']


def test_a_flat_object_that_was_taken_is_gone_and_keeps_its_id() -> None:
    world, target = ObjectWorld(), moved(BOOK, (0.3, 0.7, 0.0))
    before = only(world.look(TABLE, BOOK, times=6), 'book')
    person = track(moved(PERSON, (0.5, 0.3, 0.0)), ObjectState.PERSON, 9)
    taken = only(world.look(TABLE, times=8, tracks=(person,)), 'book')
    assert taken.state is ObjectState.GONE
    after = only(world.look(TABLE, target, times=4), 'book')
    assert after.object_id == before.object_id
    assert after.state is ObjectState.MOVED


def test_an_object_that_was_seen_four_times_keeps_its_id() -> None:
    world, target = ObjectWorld(), moved(BEAR, (0.2, -0.6, 0.0))
    before = only(world.look(TABLE, BEAR, times=4), 'teddy bear')
    person = track(moved(PERSON, (0.2, -0.6, 0.0)), ObjectState.PERSON, 9)
    world.look(TABLE, times=5, tracks=(person,))
    after = only(world.look(TABLE, target, times=4), 'teddy bear')
    assert after.object_id == before.object_id
    assert after.state is ObjectState.MOVED


@pytest.mark.parametrize('times', [3, 6])
def test_an_object_that_was_followed_keeps_its_id_at_once(times: int) -> None:
    world, target = ObjectWorld(), moved(BEAR, (0.2, -0.6, 0.0))
    rest = (track(BEAR, ObjectState.AT_REST),)
    before = only(world.look(TABLE, BEAR, times=times, tracks=rest), 'teddy bear')
    world.look(TABLE, times=5)
    down = (track(target, ObjectState.MOVED),)
    after = only(world.look(TABLE, target, tracks=down), 'teddy bear')
    assert after.object_id == before.object_id
    assert after.state is ObjectState.MOVED


def test_an_object_at_its_place_is_not_moved_by_its_track() -> None:
    world, other = ObjectWorld(), moved(BEAR, (0.2, -0.6, 0.0))
    rest = (track(BEAR, ObjectState.AT_REST),)
    before = only(world.look(TABLE, BEAR, times=6, tracks=rest), 'teddy bear')
    tracks = (track(other, ObjectState.MOVED),)
    after = only(world.look(TABLE, BEAR, other, tracks=tracks), 'teddy bear')
    assert after.object_id == before.object_id
    assert after.state is ObjectState.AT_REST


def test_visible_objects_at_rest_are_expected_where_they_are() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, BOOK, BEAR, times=5)
    world.look(TABLE, CUP, BEAR, times=6)  # the book is taken
    hiding = Box('', (1.5, -0.1, -0.45), (1.6, 0.22, 0.2))  # in front of the bear
    world.look(TABLE, CUP, BEAR, hiding)
    expected = world.map.expected
    assert expected is not None
    assert (expected.stamp_ns, expected.class_names) == (world.stamp_ns, ('cup',))
    # The cup from 1.9 m on, by the camera model.
    u, v = (
        (319.5 - 525 * y / 1.9 for y in (0.4, 0.3)),
        (239.5 + 525 * z / 1.9 for z in (0.3, 0.45)),
    )
    left, right, top, bottom = *u, *v
    assert expected.boxes_xyxy_px[0] == pytest.approx([left, top, right, bottom], abs=8)
    assert expected.scores[0] > 0.8


def test_detections_below_the_least_score_are_no_evidence() -> None:
    world, weak = ObjectWorld(min_score=0.25), CUP._replace(score=0.2)
    assert world.look(TABLE, weak, times=5) == ()
    before = only(world.look(TABLE, CUP, times=5), 'cup')
    after = only(world.look(TABLE, weak, times=3), 'cup')
    assert (after.num_sightings, after.last_ns) == (before.num_sightings, before.last_ns)
    assert after.probability < before.probability


def test_a_correction_of_the_map_moves_the_objects_with_their_keyframe() -> None:
    world = ObjectWorld()
    before = only(world.look(TABLE, CUP, times=5), 'cup')
    T = at(0.5, -0.2, 0.3)
    world.map.correct(keyframes(T, version=2))
    after = only(world.map.objects(), 'cup')
    expected = T[:3, :3] @ before.center_map_m + T[:3, 3]
    assert after.center_map_m == pytest.approx(expected, abs=1e-9)
    world.keyframes = keyframes(T, version=2)
    again = only(world.look(TABLE, CUP, T_map_world=T, times=2), 'cup')
    assert again.object_id == before.object_id
    assert again.num_sightings == 7
    assert again.center_map_m == pytest.approx(expected, abs=0.01)


def test_objects_of_a_removed_map_are_forgotten() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, times=5)
    world.map.correct(keyframes(np.eye(4), version=2, uid=5))
    assert world.map.objects() == ()


def test_a_fixed_camera_does_not_make_a_doubtful_thing_sure_by_repetition() -> None:
    doubtful, sure = BEAR._replace(score=0.35), BEAR._replace(score=0.7)
    assert ObjectWorld().look(TABLE, doubtful, times=30) == ()
    found = only(ObjectWorld().look(TABLE, sure, times=4), 'teddy bear')
    assert found.num_sightings == 4


def test_a_table_does_not_become_a_part_of_the_thing_on_it() -> None:
    """On a real desk, detections of the table made a screen grow over it."""
    world = ObjectWorld()
    before = only(world.look(TABLE, BEAR, times=6), 'teddy bear')
    table = TABLE._replace(class_name='dining table')
    after = only(world.look(table, BEAR, times=8), 'teddy bear')
    assert after.class_scores[0][0] == 'teddy bear'
    assert len(after.class_scores) == 1
    np.testing.assert_allclose(after.size_m, before.size_m, atol=0.03)


def test_the_share_of_points_in_the_box_of_an_object() -> None:
    item = thing('vase', (2.0, 0.0, 0.0))  # from 2.0 to 2.2 m, 0.0 to 0.2 m, 0.0 to 0.2 m
    points = np.array([[2.1, 0.1, 0.1], [2.15, 0.05, 0.15], [2.25, 0.1, 0.1], [2.1, 0.1, -0.4]])
    assert item.surface.contains(points, 0.0) == 0.5
    assert item.surface.contains(points, 0.1) == 0.75
    assert item.surface.contains(points[:0], 0.0) == 0


def test_the_box_leaves_out_the_outermost_points() -> None:
    points = np.column_stack([np.random.default_rng(4).permutation(101) for _ in range(3)])
    low, high = trimmed_box(points.astype(float), 0.02)
    assert low.tolist() == [2, 2, 2]
    assert high.tolist() == [98, 98, 98]
    low, high = trimmed_box(points.astype(float), 0.0)
    assert (low.tolist(), high.tolist()) == ([0, 0, 0], [100, 100, 100])
