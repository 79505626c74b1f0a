"""The object map after it was saved and loaded, in the next session, and of joined maps."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import ObjectState
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.search.object_list import Whereabouts, object_table, objects_yaml
from hoid_scene.search.object_query import ObjectQuery, find

from .object_world import Box, ObjectWorld, keyframes
from .test_object_map import BEAR, BOOK, CUP, TABLE, moved, only

UIDS = np.array([0])
HOUR_NS = 3600 * 10**9
VASE = Box('vase', (1.9, -0.65, -0.45), (2.0, -0.55, -0.15))


def next_session(state: ObjectMapState) -> ObjectWorld:
    """Return the world an hour later, with a map that has loaded the objects."""
    world = ObjectWorld()
    world.stamp_ns = HOUR_NS
    world.map.correct(world.keyframes)
    world.map.load(state, UIDS)
    return world


def test_loaded_objects_are_those_that_were_saved() -> None:
    world = ObjectWorld()
    before = world.look(TABLE, CUP, BOOK, times=6)
    after = next_session(world.map.export(UIDS)).map.objects()
    assert [item.object_id for item in after] == [item.object_id for item in before]
    for old, new in zip(before, after, strict=True):
        assert new.class_scores == old.class_scores
        assert new.T_map_object == pytest.approx(old.T_map_object, abs=1e-6)
        assert new.size_m == pytest.approx(old.size_m, abs=1e-6)
        assert (new.num_sightings, new.last_ns) == (old.num_sightings, old.last_ns)
        assert (new.state, new.is_new) == (old.state, False)


def test_a_saved_object_map_is_saved_again_unchanged() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, BOOK, times=6)
    world.look(TABLE, BOOK, times=6)
    state = world.map.export(UIDS)
    assert next_session(state).map.export(UIDS).digest() == state.digest()


def test_the_next_session_finds_the_same_objects_under_the_same_numbers() -> None:
    world = ObjectWorld()
    before = world.look(TABLE, CUP, BOOK, times=6)
    after = next_session(world.map.export(UIDS)).look(TABLE, CUP, BOOK, times=6)
    assert ids(after) == ids(before)
    assert all(item.num_sightings == 12 for item in after)


def test_the_next_session_finds_what_is_gone_moved_and_new() -> None:
    world = ObjectWorld()
    before = world.look(TABLE, CUP, BOOK, times=6)
    target = moved(BOOK, (0.1, 0.5, 0.0))
    second = next_session(world.map.export(UIDS))
    after = second.look(TABLE, target, VASE, times=10)
    book = only(after, 'book')
    assert book.state is ObjectState.MOVED
    assert book.object_id == only(before, 'book').object_id
    assert np.linalg.norm(book.center_map_m - target.center_m) < 0.06
    assert only(after, 'cup').state is ObjectState.GONE
    assert [item.class_name for item in after if item.is_new] == ['vase']
    assert [item.class_name for item in find(after, ObjectQuery(state='new'))] == ['vase']


def test_what_was_seen_five_times_is_not_called_new_yet() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, times=6)
    second = next_session(world.map.export(UIDS))
    assert [item.is_new for item in second.look(TABLE, CUP, VASE, times=5)] == [False, False]
    assert only(second.look(TABLE, CUP, VASE, times=1), 'vase').is_new


def test_what_is_much_larger_is_not_what_is_gone() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP._replace(class_name='vase'), times=6)
    large = Box('vase', (1.8, -0.5, -0.45), (2.1, -0.1, 0.1))
    after = next_session(world.map.export(UIDS)).look(TABLE, large, times=10)
    assert sorted(item.state.name for item in after) == ['AT_REST', 'GONE']


def test_a_map_that_is_loaded_beside_the_running_one_gets_other_numbers() -> None:
    world, other = ObjectWorld(), ObjectWorld()
    world.look(TABLE, CUP, times=6)
    before = other.look(TABLE, BOOK, times=6)
    other.map.load(world.map.export(UIDS), UIDS)
    after = other.map.objects()
    assert only(after, 'book').object_id == only(before, 'book').object_id
    assert only(after, 'cup').object_id != only(after, 'book').object_id


def test_the_same_thing_of_two_maps_is_joined_and_a_second_one_stays() -> None:
    first, second = ObjectWorld(), ObjectWorld()
    before = first.look(TABLE, CUP, times=6)
    second.stamp_ns = HOUR_NS
    second.look(TABLE, CUP, BEAR, times=6)
    joined = ObjectWorld()
    T = se3.exp(np.array([0.0, 0, 0.4, 0.3, 0.1, 0]))  # of both anchors, in the joined map
    joined.map.correct(keyframes(T))
    joined.map.load(first.map.export(UIDS), UIDS)
    joined.map.load(second.map.export(UIDS), UIDS)
    joined.map.join()
    after = joined.map.objects()
    assert sorted(item.class_name for item in after) == ['cup', 'teddy bear']
    cup = only(after, 'cup')
    assert cup.object_id == only(before, 'cup').object_id
    assert cup.num_sightings == 12
    expected = se3.transform(T, CUP.center_m[None])[0]
    assert np.linalg.norm(cup.center_map_m - expected) < 0.05


def test_objects_without_a_keyframe_are_left_out() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, times=6)
    assert len(world.map.export(np.array([5]))) == 0
    state = world.map.export(UIDS)
    assert len(state.with_anchors(np.array([-1]))) == 0
    assert state.with_anchors(np.array([3])).anchor.tolist() == [3]


def test_a_forgotten_object_is_not_in_the_map() -> None:
    world = ObjectWorld()
    cup = only(world.look(TABLE, CUP, times=6), 'cup')
    assert world.map.forget(cup.object_id)
    assert not world.map.forget(cup.object_id)
    assert world.map.objects() == ()
    again = only(world.look(TABLE, CUP, times=6), 'cup')
    assert again.object_id != cup.object_id


def test_objects_are_found_by_class_place_and_state() -> None:
    world = ObjectWorld()
    second = moved(CUP, (0.0, 0.2, 0.0))
    world.look(TABLE, CUP, second, BOOK, times=6)
    objects = world.look(TABLE, CUP, second, times=6)
    near = CUP.center_m
    assert classes(find(objects, ObjectQuery())) == ['cup', 'cup']
    assert classes(find(objects, ObjectQuery(state='gone'))) == ['book']
    assert classes(find(objects, ObjectQuery(state='any'))) == ['book', 'cup', 'cup']
    assert len(find(objects, ObjectQuery('cup', near, 0.1))) == 1
    nearest, other = find(objects, ObjectQuery('cup', near))
    assert np.linalg.norm(nearest.center_map_m - near) < np.linalg.norm(other.center_map_m - near)
    assert find(objects, ObjectQuery('vase')) == []


@pytest.mark.parametrize(
    ('query', 'said'),
    [
        (ObjectQuery(state='lost'), 'no state "lost"; use one of present, at_rest'),
        (ObjectQuery(near_map_m=np.full(3, np.nan)), 'the point must be finite'),
        (ObjectQuery(near_map_m=np.zeros(3), radius_m=-1.0), 'the radius not negative'),
    ],
)
def test_queries_that_make_no_sense_are_refused(query: ObjectQuery, said: str) -> None:
    with pytest.raises(InputError, match=said):
        find((), query)


def test_objects_are_listed_and_exported() -> None:
    world = ObjectWorld()
    objects = world.look(TABLE, CUP, times=6)
    header, line = object_table(objects, [Whereabouts('kitchen', ('on dining table 3',))])
    assert header.split()[:2] == ['id', 'class']
    assert line.split()[:2] == [str(objects[0].object_id), 'cup']
    assert 'kitchen, on dining table 3' in line
    assert line.endswith('at rest')
    document = yaml.safe_load(objects_yaml(objects, 'map'))
    assert document['frame'] == 'map'
    (entry,) = document['objects']
    assert entry['class'] == 'cup'
    assert entry['center'] == pytest.approx(objects[0].center_map_m.tolist(), abs=1e-3)
    assert entry['last_seen'] == pytest.approx(objects[0].last_ns / 1e9)
    assert 'moved_from' not in entry


def ids(objects: tuple[MapObject, ...]) -> dict[int, str]:
    return {item.object_id: item.class_name for item in objects}


def classes(objects: list[MapObject]) -> list[str]:
    return sorted(item.class_name for item in objects)
