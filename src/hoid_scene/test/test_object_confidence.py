"""Which objects of the map are sure, and which are forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import DynamicObject, ObjectState
from hoid_scene.grid.floor import Floor
from hoid_scene.level.upright_box import Level
from hoid_scene.objects import object_map
from hoid_scene.objects.object_surface import ObjectSurface
from hoid_scene.place import Place
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.search.object_query import ObjectQuery, find

from .object_world import LOOK_NS, Box, ObjectWorld, rendered
from .test_object_map import BEAR, BOOK, CUP, TABLE, at, only, track

TV = Box('tv', (2.0, -0.4, -0.3), (2.1, 0.4, 0.3))
FOOT = Box('cell phone', (1.98, -0.06, -0.3), (2.1, 0.06, -0.2))
LOOKS_PER_HOUR = 7200
UP = np.array([0.0, 0.0, 1.0])


def test_an_object_that_is_no_longer_likely_there_is_tentative() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, BEAR, times=6)
    assert [item.class_name for item in world.look(TABLE, BEAR, times=2)] == ['teddy bear']
    cup = only(world.map.objects(tentative=True), 'cup')
    assert cup.state is ObjectState.TENTATIVE
    assert cup.probability < 0.5
    assert only(world.look(TABLE, CUP, BEAR), 'cup').state is ObjectState.AT_REST


def test_tentative_objects_are_found_if_they_are_asked_for() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, times=2)
    assert world.map.objects() == ()
    objects = world.map.objects(tentative=True)
    assert find(objects, ObjectQuery(state='any')) == []
    (cup,) = find(objects, ObjectQuery(state='tentative'))
    assert (cup.class_name, cup.num_sightings, cup.num_views) == ('cup', 2, 1)
    assert cup.score == pytest.approx(0.9)


def test_the_number_of_views_is_kept_with_the_map() -> None:
    world = ObjectWorld()
    for y_m in (0.0, 0.5, 1.0, 1.0, 1.0):
        objects = world.look(TABLE, BEAR, T_map_body=at(0.0, y_m, -0.4 * y_m))
    before = only(objects, 'teddy bear')
    assert before.num_views == 3
    other = ObjectWorld()
    other.stamp_ns = world.stamp_ns
    other.map.correct(other.keyframes)
    other.map.load(world.map.export(np.array([0])), np.array([0]))
    assert only(other.map.objects(), 'teddy bear').num_views == 3
    again = only(other.look(TABLE, BEAR, T_map_body=at(0.0, 1.0, -0.4)), 'teddy bear')
    assert again.num_views == 3


def test_a_part_of_a_thing_that_is_called_something_else_is_no_object() -> None:
    """Such as the foot of a monitor that a detector calls a phone."""
    world = ObjectWorld()
    world.look(TV, FOOT._replace(class_name=''), times=4)
    part = FOOT._replace(high_m=(2.1, 0.06, -0.21))
    for _ in range(6):
        objects = world.look(TV._replace(class_name=''), part)
        world.look(TV, part._replace(class_name=''))
    assert [item.class_name for item in objects] == ['tv']


@pytest.mark.parametrize(('class_name', 'is_sure'), [('tv', True), ('mouse', False)])
def test_what_is_too_large_for_its_class_is_tentative(class_name: str, is_sure: bool) -> None:
    screen = TV._replace(class_name=class_name)
    world = ObjectWorld()
    for y_m in (-0.4, 0.0, 0.4, 0.8):
        objects = world.look(screen, T_map_body=at(0.0, y_m, -0.3 * y_m))
    assert [item.class_name for item in objects] == ['tv'] * is_sure
    (item,) = world.map.objects(tentative=True)
    assert item.num_sightings == 4


def test_what_stands_on_a_large_thing_stays_an_object() -> None:
    table = TABLE._replace(class_name='dining table')
    objects = ObjectWorld().look(table, CUP, BOOK, times=8)
    assert sorted(item.class_name for item in objects) == ['book', 'cup', 'dining table']


@pytest.mark.slow
def test_what_no_detector_names_any_more_is_forgotten() -> None:
    world = ObjectWorld()
    for n in range(12):
        x_m, y_m = 1.7 + 0.25 * (n % 3), -0.7 + 0.17 * (n // 3)
        low_m, high_m = (x_m, y_m, -0.45), (x_m + 0.1, y_m + 0.1, -0.3)
        world.look(TABLE, Box(f'ghost {n}', low_m, high_m), BEAR, times=4)
        world.look(TABLE, BEAR, times=6)
    gone = [item for item in world.map.objects() if item.state is ObjectState.GONE]
    assert len(gone) > 5
    world.stamp_ns += 600 * 10**9
    found = world.look(TABLE, BEAR, times=4)
    assert [item.class_name for item in found] == ['teddy bear']
    assert len(world.map) == 1


def test_an_object_that_is_gone_stays_while_its_class_is_named() -> None:
    world = ObjectWorld()
    second = Box('cup', (1.9, -0.7, -0.45), (2.0, -0.6, -0.3))
    world.look(TABLE, CUP, second, times=6)
    world.look(TABLE, second, times=6)
    world.stamp_ns += 500 * 10**9
    world.look(TABLE, second, times=2)
    world.stamp_ns += 500 * 10**9
    assert [item.state.name for item in world.look(TABLE, second, times=2)] == ['GONE', 'AT_REST']


@pytest.mark.slow
def test_the_names_of_one_object_are_bounded() -> None:
    world = ObjectWorld()
    world.look(TABLE, BEAR, times=6)
    for n in range(60):
        objects = world.look(TABLE, BEAR._replace(class_name=f'ghost {n}', score=0.2))
    bear = only(objects, 'teddy bear')
    assert len(bear.class_scores) <= 8


def test_the_number_of_voxels_of_all_objects_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, BOOK, BEAR, times=4)
    limit = world.map.num_voxels - 1
    monkeypatch.setattr(object_map, '_MAX_VOXELS', limit)
    world.look(TABLE, CUP, BEAR, times=4)
    assert 0 < world.map.num_voxels <= limit
    assert [item.class_name for item in world.map.objects()] == ['cup', 'teddy bear']


@pytest.mark.slow
def test_an_hour_of_a_flickering_detector_keeps_few_objects() -> None:
    """The detector misses half of the things, and invents others anywhere in the image."""
    world, rng = ObjectWorld(), np.random.default_rng(1)
    depth_m, seen = rendered((TABLE, CUP, BOOK, BEAR), T_BODY_OPTICAL)
    counts = []
    for n in range(LOOKS_PER_HOUR):
        left, top = rng.uniform(0, 560), rng.uniform(0, 420)
        box = left, top, left + rng.uniform(20, 80), top + rng.uniform(20, 60)
        ghost = DynamicObject(f'ghost {n % 1000}', box, 0.4, -1, ObjectState.AT_REST)
        world.stamp_ns += LOOK_NS
        request = SceneRequest(world.stamp_ns, T_BODY_OPTICAL, 0, world.keyframes, True, True)
        world.map.update(request, depth_m, [ghost, *(o for o in seen if rng.random() < 0.5)])
        counts.append(len(world.map))
    assert max(counts) < 60
    assert np.mean(counts[-1000:]) < 1.2 * np.mean(counts[500:1500])
    assert world.map.num_voxels < 100_000
    assert only(world.map.objects(), 'teddy bear').state is ObjectState.AT_REST


def test_while_an_object_is_not_sure_all_images_count() -> None:
    """Of a sure one, three images a second do."""
    world = ObjectWorld(look_ns=96_000_000)
    assert world.look(TABLE, BEAR, times=4) == ()
    assert only(world.look(TABLE, BEAR), 'teddy bear').num_sightings == 5
    assert only(world.look(TABLE, BEAR, times=20), 'teddy bear').num_sightings <= 12


@pytest.mark.parametrize(('score', 'is_sure'), [(0.3, False), (0.45, True)])
def test_weak_detections_from_one_direction_are_no_proof(score: float, is_sure: bool) -> None:
    objects = ObjectWorld().look(TABLE, BEAR._replace(score=score), times=30)
    assert [item.class_name for item in objects] == ['teddy bear'] * is_sure


def test_a_screen_that_is_too_large_for_a_laptop_is_no_laptop() -> None:
    world = ObjectWorld()
    for y_m in (-0.4, 0.0, 0.4, 0.8):
        pose = at(0.0, y_m, -0.3 * y_m)
        world.look(TV._replace(class_name='laptop'), T_map_body=pose, times=2)
        objects = world.look(TV, T_map_body=pose)
    assert [item.class_name for item in objects] == ['tv']


@pytest.mark.parametrize(('x_m', 'is_known'), [(0.8, True), (1.5, False)])
def test_a_person_in_front_handles_only_what_is_in_reach(x_m: float, is_known: bool) -> None:
    """The filter compares boxes: the head of a person covers a part of the screen."""
    screen = TV._replace(reason=ObjectState.HANDLED)
    head = Box('person', (x_m, -0.1, -1.2), (x_m + 0.2, 0.1, -0.1), ObjectState.PERSON)
    people = (track(head, ObjectState.PERSON),)
    objects = ObjectWorld().look(screen, head, times=6, tracks=people)
    assert [item.class_name for item in objects] == ['tv'] * is_known


def test_a_screen_that_is_too_high_for_a_laptop_is_no_laptop() -> None:
    """Its diagonal is that of a laptop."""
    screen = Box('laptop', (2.0, -0.18, -0.2), (2.05, 0.18, 0.2))
    world = ObjectWorld()
    world.look(screen, times=4)
    assert [item.class_name for item in world.look(screen)] == ['laptop']
    objects = world.look(screen._replace(class_name='tv'), times=3)
    assert [item.class_name for item in objects] == ['tv']
    assert objects[0].class_scores[0][0] == 'laptop'


def test_the_floor_between_the_legs_is_not_a_part_of_a_table() -> None:
    """Images show it in the box of the table, but not around it."""
    surface = ObjectSurface(Place(np.eye(4), np.eye(4), 0, 0))
    rng = np.random.default_rng(0)
    top_m = rng.uniform([-0.6, -0.4, 0.7], [0.6, 0.4, 0.72], (3000, 3))
    floor_m = rng.uniform([-0.9, -0.7, -0.03], [0.9, 0.7, 0.03], (3000, 3))
    for _ in range(3):
        surface.voxels.add_points(np.concatenate([top_m, floor_m]))
        surface.num_looks += 1
    wrong, right = (surface.upright_box(Level(UP), floor) for floor in (None, Floor(np.eye(4))))
    assert min(wrong.size_m[:2]) > 1.2
    assert sorted(right.size_m[:2]) == pytest.approx([0.8, 1.2], abs=0.07)
    assert right.low_m[2] == pytest.approx(0.0, abs=0.01)
