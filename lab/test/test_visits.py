"""Scores of what an object map says of a rearranged room, for known claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_benchmarks.rooms.placed_box import PlacedBox
from hoid_benchmarks.rooms.room_run import MappedRoom
from hoid_benchmarks.rooms.score_table import total
from hoid_benchmarks.rooms.visits.change_scores import (
    ChangeScores,
    claimed_changes,
    score_changes,
)
from hoid_benchmarks.rooms.visits.numbers import NumberScores, score_numbers
from hoid_benchmarks.rooms.visits.second_visit import first_name, first_scene, truth_of
from hoid_benchmarks.rooms.visits.true_changes import ChangeKind, TrueChange, TrueVisits
from hoid_common.values import ObjectState, Trajectory
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.objects.mapped_object import MapObject
from hoid_synth.config import SceneConfig
from rgbd_slam.mapping.slam_map import SlamStats

SIDE_M = 0.3


def true(instance: int, name: str, x_m: float, *, is_expected: bool = True) -> TrueObject:
    low, high = np.array([x_m, 0.0, 0.0]), np.array([x_m + SIDE_M, SIDE_M, SIDE_M])
    box, seen_m = PlacedBox.along_map((low + high) / 2, high - low), np.stack([low, high])
    return TrueObject(name, box, box, seen_m, is_expected, was_carried=False, instance=instance)


def mapped(number: int, name: str, x_m: float) -> MapObject:
    T = np.eye(4)
    T[:3, 3] = x_m + SIDE_M / 2, SIDE_M / 2, SIDE_M / 2
    size_m = np.full(3, SIDE_M)
    return MapObject(number, name, ((name, 1.0),), ObjectState.AT_REST, T, size_m, 9, 0, 0, 1.0)


def moved(item: MapObject, x_m: float) -> MapObject:
    place = mapped(item.object_id, item.class_name, x_m)
    return replace(place, state=ObjectState.MOVED, moved_ns=5)


CUP, BOOK, BALL, COUCH = (
    true(k, name, k) for k, name in enumerate(('cup', 'book', 'ball', 'sofa'))
)
CUP_LATER, LAPTOP = true(0, 'cup', 5.0), true(9, 'laptop', 6.0)
VISITS = TrueVisits(
    {0: CUP, 1: BOOK, 2: BALL, 3: COUCH},
    {0: CUP_LATER, 3: COUCH, 9: LAPTOP},
    (
        TrueChange(ChangeKind.MOVED, 'cup', CUP, CUP_LATER, is_expected=True),
        TrueChange(ChangeKind.GONE, 'book', BOOK, None, is_expected=True),
        TrueChange(ChangeKind.GONE, 'ball', BALL, None, is_expected=False),
        TrueChange(ChangeKind.NEW, 'laptop', None, LAPTOP, is_expected=True),
    ),
    frozenset({3}),
)
SAVED = tuple(mapped(10 + k, name, k) for k, name in enumerate(('cup', 'book', 'ball', 'sofa')))


def test_a_map_that_finds_every_change_has_full_scores() -> None:
    gone = [replace(item, state=ObjectState.GONE) for item in SAVED[1:3]]
    new = replace(mapped(20, 'laptop', 6.0), is_new=True)
    scores = score_changes(SAVED, [moved(SAVED[0], 5.0), *gone, SAVED[3], new], VISITS)
    assert scores == ChangeScores(3, 3, 3, 0, 4, 4, 4, 0, 1, 1, 0)  # the ball was not shown
    assert scores.f1 == scores.place_f1 == pytest.approx(1.0)


def test_a_moved_object_that_is_called_gone_and_new_counts_by_its_places_only() -> None:
    gone = [replace(item, state=ObjectState.GONE) for item in SAVED[:2]]
    new = replace(mapped(20, 'cup', 5.0), is_new=True)
    scores = score_changes(SAVED, [*gone, *SAVED[2:], new], VISITS)
    assert (scores.num_found, scores.num_wrong, scores.num_claims) == (1, 2, 3)
    assert scores.f1 == pytest.approx(1 / 3)
    assert (scores.num_found_places, scores.num_wrong_places) == (3, 0)
    assert scores.place_f1 == pytest.approx(2 * 0.75 / 1.75)


def test_claims_about_what_stayed_are_wrong() -> None:
    gone = replace(SAVED[3], state=ObjectState.GONE)
    double = replace(mapped(21, 'sofa', 3.02), is_new=True)
    scores = score_changes(SAVED, [*SAVED[:3], gone, double], VISITS)
    assert (scores.num_found, scores.num_claims, scores.num_wrong) == (0, 2, 2)
    assert scores.f1 == 0
    assert (scores.num_known, scores.num_same) == (1, 0)


def test_a_map_that_notices_nothing_claims_nothing() -> None:
    assert claimed_changes(SAVED, SAVED) == []
    scores = score_changes(SAVED, SAVED, VISITS)
    assert (scores.num_expected, scores.num_claims, scores.f1) == (3, 0, 0)
    twice = total([scores, scores])
    assert (twice.num_expected, twice.num_same) == (6, 2)


def test_an_object_that_the_first_visit_did_not_show_may_be_new() -> None:
    hidden = true(3, 'sofa', 3, is_expected=False)
    visits = VISITS._replace(first={**VISITS.first, 3: hidden}, unchanged=frozenset())
    new = replace(mapped(22, 'sofa', 3.0), is_new=True)
    assert score_changes(SAVED[:3], [*SAVED[:3], new], visits).num_claims == 0


def test_numbers_count_for_objects_that_are_seen_again() -> None:
    early = tuple(mapped(k, name, k) for k, name in enumerate(('cup', 'book', 'ball')))
    late = [replace(item, last_ns=9) for item in (early[0], mapped(7, 'book', 1))]
    history = {0: (), 4: early, 10: (*late, early[2])}  # the ball is not seen again
    room = MappedRoom(
        ColoredCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)), None, {},
        history[10], history, Trajectory.joined([]), SlamStats(0, 0, num_loops=1),
    )  # fmt: skip
    assert score_numbers(room, [CUP, BOOK, BALL]) == NumberScores(1, 3, 2, 2, 1)
    carried = CUP._replace(was_carried=True)
    assert score_numbers(room, [carried, BOOK, BALL]) == NumberScores(1, 2, 1, 1, 0)


@pytest.mark.slow
def test_the_true_changes_are_those_of_the_scene() -> None:
    scene = SceneConfig(seed=102, num_people=0, num_frames=60, every=5, width_px=160, away_seed=1)
    visits = truth_of(scene)
    kinds = [change.kind for change in visits.changes]
    assert kinds.count(ChangeKind.MOVED) <= 3 >= kinds.count(ChangeKind.GONE) > 0
    assert sum(change.is_expected for change in visits.changes) >= 3
    names = [change.class_name for change in visits.changes]
    assert len(set(names)) == len(names)
    assert 'dining table' in {visits.first[k].class_name for k in visits.unchanged}


def test_the_first_visit_is_the_room_as_it_was() -> None:
    assert first_name('synth-7-no-people+away=1+every=3+start=40') == 'synth-7-no-people+every=3'
    assert first_name('synth-7-away=1') == 'synth-7'
    second = SceneConfig(seed=7, away_seed=1, start_s=40.0)
    assert first_scene(second) == SceneConfig(seed=7)
