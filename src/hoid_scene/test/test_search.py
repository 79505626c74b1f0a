"""Objects are found by class and synonyms, color, place, room and time."""

from __future__ import annotations

import base64
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import Float32Array, FloatArray, ObjectState
from hoid_scene.grid.grid import FREE, UNKNOWN, Grid
from hoid_scene.memory.history import EventKind, ObjectEvent
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.search.object_list import (
    Whereabouts,
    history_lines,
    object_table,
    objects_json,
    whereabouts,
)
from hoid_scene.search.object_query import Description, ObjectQuery, find
from hoid_scene.search.relations import Relation, described, is_related
from hoid_scene.search.rooms import Rooms, find_rooms

HOUR_NS = 3600 * 10**9
CELL_M = 0.05


def thing(
    number: int,
    class_name: str,
    center_m: tuple[float, float, float],
    size_m: tuple[float, float, float],
    colors: tuple[str, ...] = (),
    yaw_rad: float = 0.0,
) -> MapObject:
    T = se3.exp(np.array([0, 0, yaw_rad, 0, 0, 0]))
    T[:3, 3] = center_m
    return MapObject(
        number, class_name, ((class_name, 8.0),), ObjectState.AT_REST, T, np.array(size_m), 10,
        HOUR_NS, 2 * HOUR_NS, 0.9, colors=colors,
    )  # fmt: skip


TABLE = thing(1, 'dining table', (1.0, 1.0, 0.37), (1.6, 0.8, 0.74), yaw_rad=0.7)
RED_CUP = thing(2, 'cup', (1.1, 1.1, 0.79), (0.08, 0.08, 0.1), ('red', 'white'))
BLUE_CUP = thing(3, 'cup', (4.0, 4.0, 0.5), (0.08, 0.08, 0.1), ('blue',))
COUCH = thing(4, 'couch', (4.0, 4.0, 0.4), (2.0, 0.9, 0.8), ('gray',))
BAG = thing(5, 'backpack', (5.3, 4.0, 0.2), (0.3, 0.3, 0.4))
BALL = thing(6, 'sports ball', (1.0, 1.0, 0.1), (0.2, 0.2, 0.2))
SINK = thing(7, 'sink', (8.0, 0.0, 0.8), (0.6, 0.5, 0.3))
SPOON = thing(8, 'spoon', (8.0, 0.0, 0.75), (0.15, 0.03, 0.02))
PHONE = thing(9, 'cell phone', (0.4, 0.5, 0.75), (0.15, 0.08, 0.02))
ALL = (TABLE, RED_CUP, BLUE_CUP, COUCH, BAG, BALL, SINK, SPOON, PHONE)


@pytest.mark.parametrize(
    ('words', 'numbers'),
    [
        ('', [1, 2, 3, 4, 5, 6, 7, 8, 9]),
        ('cup', [2, 3]),
        ('Where is my mug?', [2, 3]),
        ('cups', [2, 3]),
        ('sofa', [4]),
        ('phone', [9]),
        ('bag', [5]),
        ('rucksack', [5]),
        ('handbag', []),
        ('red cup', [2]),
        ('the white cup', [2]),
        ('green cup', []),
        ('grey sofa', [4]),
        ('blue things', [3]),
        ('cup on the table', [2]),
        ('mug on top of the desk', [2]),
        ('cup on the couch', [3]),
        ('red cup on the couch', []),
        ('anything on the table', [2, 9]),
        ('ball under the table', [6]),
        ('bag next to the sofa', [5]),
        ('spoon in the sink', [8]),
        ('things in the kitchen', [7, 8]),
        ('cup in the living room', [3]),
        ('cup on the sofa in the living room', [3]),
        ('cup in the garden', []),
    ],
)
def test_words_find_objects(words: str, numbers: list[int]) -> None:
    def room_of(item: MapObject) -> str:
        return {'sink': 'kitchen', 'spoon': 'kitchen'}.get(
            item.class_name, 'living room' if item.center_map_m[0] > 3 else 'office'
        )

    assert [item.object_id for item in find(ALL, ObjectQuery(words), room_of)] == numbers


def test_a_class_of_a_detector_is_found_by_its_own_name_only() -> None:
    odd = replace(RED_CUP, class_name='Red Cup on saucer')
    assert find((odd, RED_CUP), ObjectQuery('red cup on saucer')) == [odd]
    assert Description.of('orange').color == ''
    assert Description.of('orange cup').color == 'orange'


def test_rooms_are_not_asked_for_without_need() -> None:
    def room_of(item: MapObject) -> str:
        raise AssertionError(item)

    assert find(ALL, ObjectQuery('cup on the table'), room_of) == [RED_CUP]
    assert find(ALL, ObjectQuery('spoon in the sink'), room_of) == [SPOON]


def test_words_of_a_book_are_refused() -> None:
    with pytest.raises(InputError, match='200 characters at most'):
        find(ALL, ObjectQuery('cup ' * 51))


def test_a_relation_follows_the_box_as_it_is_turned() -> None:
    assert is_related(RED_CUP, Relation.ON, TABLE)
    corner = replace(RED_CUP, T_map_object=at(0.35, 1.3, 0.79))
    assert not is_related(corner, Relation.ON, TABLE)
    straight = replace(TABLE, T_map_object=at(1.0, 1.0, 0.37))
    assert is_related(corner, Relation.ON, straight)
    assert described(RED_CUP, ALL) == ('on dining table 1',)
    assert described(BAG, ALL) == ('next to couch 4',)
    assert described(replace(SINK, T_map_object=at(0, 9, 0)), ALL) == ()


def at(x: float, y: float, z: float) -> FloatArray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def test_objects_that_were_moved_since_a_time_are_found() -> None:
    events = (
        ObjectEvent(HOUR_NS, EventKind.NEW),
        ObjectEvent(2 * HOUR_NS, EventKind.CARRIED, 3),
        ObjectEvent(2 * HOUR_NS + 8 * 10**9, EventKind.PUT_DOWN, 3, 1.523),
        ObjectEvent(9 * HOUR_NS, EventKind.SEEN),
    )
    cup = replace(RED_CUP, events=events)
    for since_ns, is_found in ((1, True), (2 * HOUR_NS + 1, True), (3 * HOUR_NS, False)):
        assert (cup in find((cup, TABLE), ObjectQuery(moved_since_ns=since_ns))) == is_found
    assert list(history_lines(cup)) == [
        '2 cup',
        '  1970-01-01 01:00:00  new',
        '  1970-01-01 02:00:00  carried by person 3',
        '  1970-01-01 02:00:08  put down 1.52 m away by person 3',
        '  1970-01-01 09:00:00  seen again',
    ]


def test_a_list_has_color_and_place_and_json_has_all() -> None:
    jpeg = cv2.imencode('.jpg', np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    cup = replace(RED_CUP, jpeg=jpeg, events=(ObjectEvent(HOUR_NS, EventKind.NEW),))
    where = [whereabouts(cup, ALL, None)]
    assert where == [Whereabouts('', ('on dining table 1',))]
    _, line = object_table([cup], where)
    assert 'red white' in line
    assert 'on dining table 1' in line
    document = json.loads(objects_json([cup], where, 'map'))
    assert document['format'] == 'hoid objects 1'
    (entry,) = document['objects']
    assert entry['places'] == ['on dining table 1']
    assert entry['orientation'] == [0, 0, 0, 1]
    assert entry['history'] == [{'time': 3600.0, 'event': 'new', 'person': -1, 'distance': 0.0}]
    assert base64.b64decode(entry['picture']) == jpeg


def flat(
    width_m: float, depth_m: float, *walls: tuple[float, float, float, float]
) -> tuple[Grid, Float32Array]:
    """Return a grid, free but for walls (x1, y1, x2, y2) [m], and points of walls and floor."""
    shape = round(depth_m / CELL_M), round(width_m / CELL_M)
    cells = np.full(shape, FREE, np.int8)
    grid = Grid(cells, CELL_M, at(3.0, -2.0, 0.5), (-20, 10))
    points = []
    for x1, y1, x2, y2 in walls:
        xs, ys = np.arange(x1, x2 + 1e-9, 0.025), np.arange(y1, y2 + 1e-9, 0.025)
        heights = np.arange(0.1, 2.5, 0.025)
        points.append(np.stack(np.meshgrid(xs, ys, heights), -1).reshape(-1, 3))
    xyz = np.concatenate(points) if points else np.zeros((0, 3))
    return grid, se3.transform(grid.T_map_origin, xyz).astype(np.float32)


def box_m(x1: float, y1: float, x2: float, y2: float) -> list[tuple[float, float, float, float]]:
    """Return the four walls of a rectangle."""
    return [(x1, y1, x2, y1), (x1, y2, x2, y2), (x1, y1, x1, y2), (x2, y1, x2, y2)]


def test_a_door_divides_rooms_and_a_wide_opening_does_not() -> None:
    outer = box_m(0.05, 0.05, 8.9, 4.9)
    door = [(4.5, 0.05, 4.6, 2.0), (4.5, 2.95, 4.6, 4.9)]
    opening = [(4.5, 0.05, 4.6, 1.0), (4.5, 2.95, 4.6, 4.9)]
    grid, points = flat(9, 5, *outer, *door)
    labels = find_rooms(grid, points)
    assert set(np.unique(labels)) == {0, 1, 2}
    assert labels[50, 20] != labels[50, 160]
    assert np.count_nonzero(labels == labels[50, 20]) * CELL_M**2 == pytest.approx(21.3, abs=1.0)
    grid, points = flat(9, 5, *outer, *opening)
    assert set(np.unique(find_rooms(grid, points))) == {0, 1}


def test_a_table_in_the_way_divides_no_room() -> None:
    grid, points = flat(6, 5, *box_m(0.05, 0.05, 5.9, 4.9))
    table = np.stack(np.meshgrid(np.arange(2, 4, 0.025), np.arange(0.9, 4.1, 0.025)), -1)
    top = np.dstack([table, np.full(table.shape[:2], 0.75)]).reshape(-1, 3)
    points = np.concatenate([points, se3.transform(grid.T_map_origin, top).astype(np.float32)])
    assert set(np.unique(find_rooms(grid, points))) == {0, 1}


def test_a_strip_that_nobody_has_seen_divides_no_room() -> None:
    grid, points = flat(6, 5, *box_m(0.05, 0.05, 5.9, 4.9))
    grid.cells[:, 50:66] = UNKNOWN
    assert set(np.unique(find_rooms(grid, points))) == {0, 1}


def test_rooms_are_named_by_what_is_in_them() -> None:
    walls = box_m(0.05, 0.05, 11.9, 4.9)
    doors = [box for x in (4.0, 8.0) for box in ((x, 0.05, x + 0.1, 2.0), (x, 2.9, x + 0.1, 4.9))]
    grid, points = flat(12, 5, *walls, *doors)
    labels = find_rooms(grid, points)

    def placed(item: MapObject, x: float, y: float) -> MapObject:
        return replace(item, T_map_object=grid.T_map_origin @ at(x, y, 0.4))

    oven, couch = placed(replace(SINK, class_name='oven'), 1.0, 4.8), placed(COUCH, 6.0, 2.0)
    rooms = Rooms(labels, grid, [oven, couch])
    assert sorted(rooms.names) == ['kitchen', 'living room', 'room 1']
    assert rooms.name_of(oven) == 'kitchen'
    assert rooms.name_of(placed(RED_CUP, 5.0, 1.0)) == 'living room'
    assert rooms.name_of(placed(RED_CUP, 11.0, 1.0)) == 'room 1'
    assert rooms.name_of(placed(RED_CUP, 30.0, 1.0)) == ''


def test_what_nobody_has_seen_is_in_no_room() -> None:
    grid, points = flat(6, 5)
    unknown = replace(grid, cells=np.full(grid.cells.shape, UNKNOWN, np.int8))
    assert not find_rooms(unknown, points).any()
    assert Rooms(find_rooms(unknown, points), unknown, [COUCH]).name_of(COUCH) == ''
