"""`hoid bench rooms`: dense map, grid and tracks of rendered rooms, compared with ground truth.

Each room is mapped with several filter strategies and without a filter. Boxes are ground truth
unless a detector is named. A second table compares the objects at rest with the true ones, and a
third one shows how the maps follow the objects that people carry. A room that was rearranged
(`synth-1-away=1`) is mapped as it was before first; a fourth table shows what the object map says
of the changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.jobs.code import Code
from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.plan.sequences import Store, scene_of
from hoid_benchmarks.rooms.carries import (
    CarryScores,
    count_filled,
    placed_objects,
    placed_tracks,
    score_carries,
    true_carries,
)
from hoid_benchmarks.rooms.object_scores import FoundObject, ObjectScores, score_objects
from hoid_benchmarks.rooms.object_truth import TrueObject, true_objects
from hoid_benchmarks.rooms.placed_box import PlacedBox
from hoid_benchmarks.rooms.room_ghost import Ghost
from hoid_benchmarks.rooms.room_run import MappedRoom, map_room
from hoid_benchmarks.rooms.room_scores import RoomScores, score
from hoid_benchmarks.rooms.score_table import (
    ScoreTable,
    carry_table,
    change_table,
    number_table,
    object_table,
)
from hoid_benchmarks.rooms.visits.change_scores import ChangeScores, score_changes
from hoid_benchmarks.rooms.visits.numbers import NumberScores, score_numbers
from hoid_benchmarks.rooms.visits.second_visit import first_name, map_visits, truth_of
from hoid_bringup.run.provenance import machine
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common.errors import InputError
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_synth.config import SceneConfig
from hoid_synth.room_truth import RoomTruth

ROOMS = ('synth-1', 'synth-2')
_STRATEGIES = ('hoid+', 'hoid2d', 'none')
_TRACKS, _MAP = '`tracked_objects`', '`object_map`'
_GHOST_FRAMES = 180
_ROOT = Path(__file__).parents[3]
_HEADER = (
    'room', 'filter', 'points', 'within 3 cm', 'where people walked', 'grid cells right',
    'level deg', 'people', 'new places filled', 'undetected',
)  # fmt: skip
_WANTED = (
    'wanted', '', '', '>= 99 %', '< 0.1 %', '>= 97 %', '< 2', '< 20 cm', 'all', '-> 0',
)  # fmt: skip


class Tables(NamedTuple):
    """The tables of objects at rest, carried objects, numbers and changes."""

    objects: ScoreTable[ObjectScores]
    carries: ScoreTable[CarryScores]
    numbers: ScoreTable[NumberScores]
    changes: ScoreTable[ChangeScores]


def room_report(names: Sequence[str], store: Store, detector: str | None = None) -> str:
    """Return Markdown tables with the scores of rooms.

    Args:
        names: Rendered recordings, such as synth-3; empty means the two default ones.
        store: Folders of the recordings; a missing recording is rendered.
        detector: Detector model to use instead of ground-truth boxes.

    Raises:
        InputError: A name is not that of a rendered recording.
    """
    rows: list[tuple[str, ...]] = [_WANTED]
    tables = Tables(object_table(), carry_table(), number_table(), change_table())
    model = detector or TRUTH
    for name in names or ROOMS:
        scene = _scene(name)
        if scene.away_seed:
            _add_visits(name, scene, store, model, tables.changes)
        else:
            rows += _rows(name, scene, store, model, tables)
    texts = [markdown_table(_HEADER, rows) if len(rows) > 1 else '', *(t.text() for t in tables)]
    made = f'Made at commit {Code.of(_ROOT).commit}, on {machine()}'
    text = '\n'.join(filter(None, texts))
    return f'{text}\n{made}, with {detector or "ground-truth boxes"}.\n'


def _scene(name: str) -> SceneConfig:
    scene = scene_of(name)
    if scene is None:
        raise InputError(f'{name}: ground truth is known for rendered rooms only, such as synth-1')
    return scene


def _add_visits(
    name: str, scene: SceneConfig, store: Store, model: str, table: ScoreTable[ChangeScores]
) -> None:
    """Map a room before and after it was rearranged, and score what the object map says."""
    config = RunConfig().updated({'detector.model': model, 'object_map.enabled': True})
    visits = map_visits(store.find(first_name(name)), store.find(name), config)
    true = truth_of(scene)
    for mode, now in visits.now.items():
        table.add(name, score_changes(visits.saved, now, true), mode)


def _rows(
    name: str,
    scene: SceneConfig,
    store: Store,
    model: str,
    tables: Tables,
) -> Iterable[tuple[str, ...]]:
    """Yield the rows of one room; the objects found with the first strategy are scored."""
    ghost = _ghost(name, scene.seed, store) if scene.num_people else '-'
    sequence = BagSequence(store.find(name))
    truth = RoomTruth(scene, T_BODY_OPTICAL)
    true, carries = true_objects(truth), true_carries(truth, sequence)
    for strategy in _STRATEGIES if scene.num_people else _STRATEGIES[:1]:
        config = RunConfig().updated(
            {'filter.strategy': strategy, 'detector.model': model, 'object_map.enabled': True}
        )
        room = map_room(sequence, config)
        if strategy == _STRATEGIES[0]:
            _add_objects(name, room, true, tables.objects)
            for source, history in (
                (_TRACKS, placed_tracks(room.tracks)),
                (_MAP, placed_objects(room.history)),
            ):
                tables.carries.add(name, score_carries(history, carries, truth), source)
            tables.numbers.add(name, score_numbers(room, true))
        filled = count_filled(true, room.cloud.points_m.astype(np.float64))
        places = f'{filled[0]} of {filled[1]}'
        yield f'`{name}`', f'`{strategy}`', *_cells(score(room, truth)), places, ghost


def _add_objects(
    name: str, room: MappedRoom, true: Sequence[TrueObject], table: ScoreTable[ObjectScores]
) -> None:
    """Score the objects at rest at the end: those of `tracked_objects`, and of the object map."""
    tracks = [
        FoundObject(track.class_name, PlacedBox.along_map(track.position_map_m, track.size_m))
        for track in (room.tracks[max(room.tracks)] if room.tracks else ())
        if track.state.is_at_rest
    ]
    mapped = [
        FoundObject(item.class_name, PlacedBox(item.T_map_object, item.size_m))
        for item in room.objects
        if item.is_present
    ]
    table.add(name, score_objects(tracks, true), _TRACKS)
    table.add(name, score_objects(mapped, true), _MAP)


def _ghost(name: str, seed: int, store: Store) -> str:
    """Return the map points on an undetected person when the person leaves, and 2 s later."""
    sequence = BagSequence(store.find(f'{name}-no-people+frames={_GHOST_FRAMES}'))
    scene = SceneConfig(seed=seed, num_people=0, num_frames=_GHOST_FRAMES)
    config = RunConfig().updated({'filter.strategy': 'none'})
    ghost = Ghost(RoomTruth(scene, T_BODY_OPTICAL), config)
    map_room(sequence, config, [ghost])
    return f'{ghost.num_standing} -> {ghost.num_left}' if ghost.num_standing else 'no place'


def _cells(scores: RoomScores) -> tuple[str, ...]:
    return (
        str(scores.num_points),
        f'{100 * scores.near_share:.2f} %',
        f'{100 * scores.path_share:.3f} %',
        f'{100 * scores.grid_share:.1f} %',
        f'{scores.level_deg:.1f}',
        f'{100 * scores.people_m:.0f} cm' if np.isfinite(scores.people_m) else '-',
    )
