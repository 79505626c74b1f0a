"""Colors, pictures and histories of objects: how they are made, saved, loaded and joined."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import MapFileError
from hoid_common.store.database import SUFFIX
from hoid_common.values import ByteArray, DynamicObject, ObjectState
from hoid_scene.memory.colors import color_counts, color_names
from hoid_scene.memory.history import MAX_EVENTS, EventKind, History, ObjectEvent, PresentState
from hoid_scene.memory.object_memory import (
    MAX_JPEG_BYTES,
    Look,
    MemoryState,
    ObjectMemory,
    remember,
)
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import SavedScene, exported_objects, join_scenes

from .object_world import CAMERA, ObjectWorld, keyframes
from .test_object_map import BOOK, CUP, TABLE, moved, only
from .test_saved_objects import HOUR_NS, UIDS, next_session
from .test_scene_file import saved

RED, WHITE, DARK_ORANGE = (30, 20, 200), (230, 235, 240), (20, 60, 110)
DAY_NS = 24 * HOUR_NS


@pytest.mark.parametrize(
    ('bgr', 'name'),
    [
        (RED, 'red'),
        (WHITE, 'white'),
        (DARK_ORANGE, 'brown'),
        ((10, 10, 12), 'black'),
        ((110, 112, 108), 'gray'),
        ((20, 130, 250), 'orange'),
        ((30, 220, 240), 'yellow'),
        ((60, 160, 40), 'green'),
        ((200, 90, 30), 'blue'),
        ((160, 40, 110), 'purple'),
        ((190, 160, 240), 'pink'),
    ],
)
def test_colors_have_their_usual_names(bgr: tuple[int, int, int], name: str) -> None:
    assert color_names(color_counts(np.full((50, 3), bgr, np.uint8))) == (name,)


def test_an_object_of_two_colors_has_two_names() -> None:
    pixels = np.array([RED] * 60 + [WHITE] * 30 + [(10, 10, 10)] * 10, np.uint8)
    assert color_names(color_counts(pixels)) == ('red', 'white')
    assert color_names(color_counts(np.empty((0, 3), np.uint8))) == ()


def image(bgr: tuple[int, int, int] = RED) -> ByteArray:
    return np.full((CAMERA.height_px, CAMERA.width_px, 3), bgr, np.uint8)


def look(
    memory: ObjectMemory, *, score: float = 0.8, num: int = 400, is_cut: bool = False
) -> Look:
    detection = DynamicObject('cup', (100, 100, 180, 200), score, -1, ObjectState.AT_REST)
    return Look(memory, detection, np.arange(num), is_cut)


def test_the_best_picture_is_kept_and_images_are_asked_for_only_then() -> None:
    memory = ObjectMemory()
    asked: list[tuple[int, int, int]] = []

    def shown(bgr: tuple[int, int, int], *people: DynamicObject, **how: Any) -> bool:
        before = memory.jpeg, len(asked)

        def decode() -> ByteArray:
            asked.append(bgr)
            return image(bgr)

        remember([look(memory, **how)], people, decode, 4, len(asked))
        assert (len(asked) > before[1]) == (memory.jpeg != before[0])
        return memory.jpeg != before[0]

    person = DynamicObject('person', (90, 90, 170, 210), 0.9, -1, ObjectState.PERSON)
    assert shown(RED)
    assert not shown(WHITE)  # as good as the first
    assert not shown(WHITE, num=1000, is_cut=True)
    assert not shown(WHITE, person, num=1600)
    assert shown(WHITE, num=1000)
    height, width = decoded(memory.jpeg).shape[:2]
    assert (width, height) == (96, 120)  # the box and a tenth of it on each side
    assert memory.color_names == ('white', 'red')


def decoded(jpeg: bytes) -> ByteArray:
    found = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert found is not None
    return np.asarray(found, np.uint8)


def test_no_picture_has_more_than_20_kb() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (1080, 1920, 3)).astype(np.uint8)
    for crop in (noise, noise[:300, :300], noise[:1], noise[:1, :1]):
        memory = ObjectMemory()
        memory.put_picture(crop, 1.0, 0)
        assert 0 < len(memory.jpeg) <= MAX_JPEG_BYTES
        assert max(decoded(memory.jpeg).shape[:2]) <= 320


def test_an_object_map_names_the_colors_of_its_objects() -> None:
    world = ObjectWorld()
    world.color = image()
    cup = only(world.look(TABLE, CUP, times=6), 'cup')
    assert cup.colors == ('red',)
    assert decoded(cup.jpeg).mean((0, 1)) == pytest.approx(RED, abs=6)
    assert only(ObjectWorld().look(TABLE, CUP, times=6), 'cup').jpeg == b''


def kinds(item: MapObject) -> list[str]:
    return [event.kind.name for event in item.events]


def test_the_history_tells_what_was_new_gone_seen_again_and_put_down() -> None:
    world = ObjectWorld()
    book = only(world.look(TABLE, CUP, BOOK, times=6), 'book')
    assert kinds(book) == ['NEW']
    assert book.events[0].stamp_ns == book.first_ns
    book = only(world.look(TABLE, CUP, times=8), 'book')
    assert kinds(book) == ['NEW', 'GONE']
    assert book.events[1].stamp_ns > book.last_ns
    book = only(world.look(TABLE, CUP, BOOK, times=2), 'book')
    assert kinds(book) == ['NEW', 'GONE', 'SEEN']
    world.stamp_ns += HOUR_NS
    cup = only(world.look(TABLE, CUP, BOOK, times=2), 'cup')
    assert kinds(cup) == ['NEW', 'SEEN']
    assert cup.events[1].stamp_ns == world.stamp_ns - 500_000_000


def test_the_next_session_goes_on_with_colors_picture_and_history() -> None:
    world = ObjectWorld()
    world.color = image()
    before = only(world.look(TABLE, CUP, BOOK, times=6), 'book')
    scene = exported_objects(world.map, UIDS)
    assert scene.objects is not None
    target = moved(BOOK, (0.1, 0.5, 0.0))
    second = ObjectWorld()
    second.stamp_ns = HOUR_NS
    second.map.correct(second.keyframes)
    second.map.load(scene.objects, UIDS, scene.memories)
    book = only(second.map.objects(), 'book')
    assert (book.colors, book.jpeg, book.events) == (before.colors, before.jpeg, before.events)
    book = only(second.look(TABLE, CUP, target, times=10), 'book')
    assert book.object_id == before.object_id
    assert kinds(book)[0] == 'NEW'
    assert kinds(book)[-1] == 'PUT_DOWN'
    assert book.events[-1].distance_m == pytest.approx(np.hypot(0.1, 0.5), abs=0.06)
    assert (book.colors, book.jpeg) == (before.colors, before.jpeg)


def test_objects_of_a_map_without_memories_begin_a_history() -> None:
    world = ObjectWorld()
    world.look(TABLE, CUP, BOOK, times=6)
    second = next_session(world.map.export(UIDS))
    after = second.look(TABLE, CUP, times=10)
    assert kinds(only(after, 'cup')) == ['NEW', 'SEEN']
    assert kinds(only(after, 'book')) == ['NEW', 'GONE']


def test_joined_maps_keep_both_histories_of_the_same_object() -> None:
    first, second = ObjectWorld(), ObjectWorld()
    second.stamp_ns = DAY_NS
    first.look(TABLE, CUP, times=6)
    second.look(TABLE, CUP, times=6)
    second.look(TABLE, times=8)
    second.look(TABLE, CUP, times=6)
    scenes = [exported_objects(world.map, UIDS) for world in (first, second)]
    T = se3.exp(np.array([0.0, 0, 0.4, 0.3, 0.1, 0]))
    joined = join_scenes(scenes, keyframes(T), CAMERA).scene
    (memory,) = joined.memories.values()
    events = ObjectMemory.of(memory).history.events
    assert [event.kind.name for event in events] == ['NEW', 'GONE', 'SEEN']
    assert events[0].stamp_ns < HOUR_NS < DAY_NS < events[1].stamp_ns


def test_a_carried_object_tells_who_took_it_and_put_it_down() -> None:
    history = History()
    history.continue_from(1, 0)
    at_rest = PresentState(ObjectState.AT_REST, 1, 5, 0, 0, 0.0, -1)
    history.note(at_rest, 5)
    handled = at_rest._replace(state=ObjectState.HANDLED, left_ns=8, person_id=3)
    assert history.note(handled, 9)
    assert not history.note(handled, 10)
    put_down = handled._replace(state=ObjectState.MOVED, last_ns=20, moved_ns=5, moved_m=1.5)
    assert history.note(put_down, 21)
    assert not history.note(put_down._replace(last_ns=30), 30)
    assert history.events == (
        ObjectEvent(1, EventKind.NEW),
        ObjectEvent(8, EventKind.CARRIED, 3),
        ObjectEvent(21, EventKind.PUT_DOWN, 3, 1.5),
    )


def test_a_history_is_bounded_and_keeps_its_beginning() -> None:
    history = History()
    history.add(ObjectEvent(n, EventKind.NEW if n == 0 else EventKind.SEEN) for n in range(500))
    assert len(history.events) == MAX_EVENTS
    assert history.events[0] == ObjectEvent(0, EventKind.NEW)
    assert [event.stamp_ns for event in history.events[1:]] == list(range(401, 500))


def valid() -> SavedScene:
    world = ObjectWorld()
    world.color = image()
    world.look(TABLE, CUP, times=6)
    world.look(TABLE, times=8)
    return exported_objects(world.map, UIDS)


def with_memory(scene: SavedScene, memories: Iterable[MemoryState]) -> SavedScene:
    return scene._replace(memories=dict(zip(scene.memories, memories, strict=True)))


def test_memories_in_a_map_file_come_back_unchanged(tmp_path: Path) -> None:
    scene = valid()
    back = scene_file.read_file(saved(tmp_path / f'a{SUFFIX}', scene))
    before = {key: memory.digest() for key, memory in scene.memories.items()}
    assert {key: memory.digest() for key, memory in back.memories.items()} == before
    loaded = [ObjectMemory.of(memory).state().digest() for memory in back.memories.values()]
    assert loaded == list(before.values())


BAD_JPEG = cv2.imencode('.jpg', np.zeros((400, 30, 3), np.uint8))[1]
FAULTS: dict[str, tuple[str, dict[str, Any]]] = {
    'kind': ('event of an object is unknown', {'kind': np.array([1, 9], np.uint8)}),
    'order': ('not sorted', {'stamp_ns': np.array([2, 1])}),
    'stamp': ('stamp is out of range', {'stamp_ns': np.array([-1, 1])}),
    'person': ('person of an event', {'person_id': np.array([-2, 1])}),
    'distance': ('distance of an event', {'distance_m': np.array([0, np.nan])}),
    'colors': ('colored pixels', {'color_px': np.full(11, -1)}),
    'rank': ('rank of a picture', {'picture_rank': np.array([np.inf])}),
    'picture stamp': ('stamp is out of range', {'picture_ns': np.array([-1])}),
    'long picture': ('too many bytes', {'jpeg': np.zeros(20_001, np.uint8)}),
    'no picture': ('no small JPEG', {'jpeg': np.zeros(100, np.uint8)}),
    'large picture': ('no small JPEG', {'jpeg': BAD_JPEG}),
    'long': (
        'history of an object is too long',
        {
            'stamp_ns': np.arange(101),
            'kind': np.full(101, 2, np.uint8),
            'person_id': np.full(101, -1),
            'distance_m': np.zeros(101),
        },
    ),
}


@pytest.mark.parametrize('name', FAULTS)
def test_memories_that_break_a_rule_are_refused(tmp_path: Path, name: str) -> None:
    said, columns = FAULTS[name]
    scene, path = valid(), tmp_path / f'a{SUFFIX}'
    broken = [replace(memory, **columns) for memory in scene.memories.values()]
    saved(path, with_memory(scene, broken))
    with pytest.raises(MapFileError, match=said):
        scene_file.read_file(path)
