"""Keeps the id of an object while a person carries it to another place.

The object tracker (`object_tracker`) follows an object while a person carries it. The map uses the
number of the object's track, which is the same at the old and at the new place. If the track was
lost on the way, the map compares both places: the old place is seen without the object, and a
person was at the new place before the object was found there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S, FloatArray, ObjectState
from hoid_scene.objects.mapped_object import MappedObject
from hoid_scene.objects.segmentation import Segment
from hoid_scene.tracks.object_track import FRESH_NS, REACH_M, TrackedObject

# None of these numbers was tuned.
_SAME_M = 0.35  # a settled track nearer than this to an object is the object's track
_AWAY_M = 0.3  # an object is carried if its handled track is at least this far from its place
# Number of successive images that must show the old place empty before an object counts as
# handled.
_MIN_THROUGH = 2
_FEW_SIGHTINGS = 4  # fewer do not prove that an object was at rest; chosen on seeds 83, 85
# Smallest ratio of the images that showed an object with few sightings in which it must have been
# detected.
_STABLE_RATIO = 0.75
# Furniture that one person does not carry; chosen.
_HEAVY = frozenset({'couch', 'bed', 'dining table', 'refrigerator', 'oven', 'toilet', 'sink'})
# Number of successive images that must show the old place without a detection of the object, empty
# or not, before it may be an object that a person has put down elsewhere.
_MIN_ABSENT = 4
_ADOPT_NS = 600 * NS_PER_S  # an object that has left its place for longer gets a new number
# Largest ratio of the sizes of an old and a new object that may be the same object.
_MAX_RATIO = 1.6
# Time for which the places of people are remembered. An object that was not seen for longer may
# have been moved while no camera was watching.
_VISIT_NS = 60 * NS_PER_S
_EARLY_NS = NS_PER_S  # a person may hide an object for so long before it leaves its place


class _Visit(NamedTuple):
    """The positions of people in one image."""

    stamp_ns: int
    positions_map_m: FloatArray  # (P, 3)


class Carrying:
    """Links tracks to objects of the map, and moves objects that were put down elsewhere."""

    def __init__(self) -> None:
        self._visits: deque[_Visit] = deque()

    def follow(
        self, objects: list[MappedObject], tracks: Sequence[TrackedObject], stamp_ns: int
    ) -> list[MappedObject]:
        """Update which objects people handle, and recognize objects that were carried elsewhere.

        Return the objects; a new object that is a carried older object is merged into it.
        """
        people = [track for track in tracks if track.state is ObjectState.PERSON]
        self._note_people(people, stamp_ns)
        by_id = {track.track_id: track for track in tracks}
        _link(objects, tracks)
        for item in objects:
            track = by_id.get(item.track_id)
            is_fixed = item.class_name in _HEAVY or not item.is_confirmed
            if track is not None and item.is_present and not is_fixed:
                _note_handled(item, track, people, stamp_ns)
        return self._joined(objects, by_id, stamp_ns)

    def _note_people(self, people: Sequence[TrackedObject], stamp_ns: int) -> None:
        if people:
            at = np.array([person.position_map_m for person in people])
            self._visits.append(_Visit(stamp_ns, at))
        while self._visits and not 0 <= stamp_ns - self._visits[0].stamp_ns <= _VISIT_NS:
            self._visits.popleft()

    def _joined(
        self, objects: list[MappedObject], tracks: dict[int, TrackedObject], stamp_ns: int
    ) -> list[MappedObject]:
        """Move each object that has left its place to the place of the matching new object.

        Return the objects without these new objects.
        """
        new = [
            item for item in objects if item.is_present and (item.is_confirmed or item.was_carried)
        ]
        removed: set[int] = set()
        for item in sorted(objects, key=_join_order):
            is_fixed = item.class_name in _HEAVY and not item.is_loaded
            if is_fixed or not item.is_confirmed or item.object_id in removed:
                continue
            fitting = [
                (rank, other.evidence.first_ns, other.object_id, other)
                for other in new
                if other.object_id not in removed
                and (rank := self._rank(item, other, tracks, stamp_ns)) > 0
            ]
            if fitting:
                *_, found = min(fitting, key=lambda row: (-row[0], *row[1:3]))
                item.move_to(found)
                removed.add(found.object_id)
        return [item for item in objects if item.object_id not in removed]

    def _rank(
        self,
        item: MappedObject,
        other: MappedObject,
        tracks: dict[int, TrackedObject],
        stamp_ns: int,
    ) -> int:
        """Return the strength of the evidence that two objects are the same; 0: no evidence.

        `other` must be of the same class, and seen first after the last sighting of `item`.
        3: they have the same track. 2: the place of `item` is seen without it, and `other` was
        carried to its place. 1: the place of `item` is empty, and since then a person was at the
        place of `other`, or `item` was out of view for a minute. `other` must be confirmed and
        `item` reliable, unless `item` has left and its track was carried to `other`.
        """
        if not _may_be(item, other):
            return 0
        seen = item.evidence
        has_left = not item.is_present or seen.num_through >= _MIN_THROUGH
        is_sure = other.is_confirmed and _is_reliable(item)
        if item.track_id == other.track_id != -1 and other.was_carried + has_left + is_sure >= 2:
            return 3
        track = tracks.get(item.track_id)
        is_other = not _is_as_large(item, other) or _is_elsewhere(track, (item, other), stamp_ns)
        if is_other or not is_sure:
            return 0
        if other.was_carried and (seen.num_absent >= _MIN_ABSENT or not item.is_present):
            return 2
        if item.is_present or stamp_ns - item.left_ns > _ADOPT_NS:
            return 0
        is_long_ago = item.is_loaded or other.evidence.first_ns - seen.last_ns > _VISIT_NS
        return int(is_long_ago or self._was_visited(other, seen.last_ns - _EARLY_NS))

    def _was_visited(self, item: MappedObject, since_ns: int) -> bool:
        """Return whether a person was within reach of an object before it was found."""
        at = [
            visit.positions_map_m
            for visit in self._visits
            if since_ns <= visit.stamp_ns <= item.evidence.first_ns
        ]
        if not at:
            return False
        offsets_m = (np.concatenate(at) - item.surface.center_map_m())[:, :2]
        return bool(np.linalg.norm(offsets_m, axis=1).min() < REACH_M)


def within_reach(segment: Segment, tracks: Sequence[TrackedObject]) -> Segment:
    """Return a segment, changed to at rest if it is handled but nobody is within reach.

    The filter compares boxes in the image, in which a person may be far in front of an object. If
    no person is tracked, the state of the filter is kept.
    """
    state = segment.detection.state
    people_m = [item.position_map_m for item in tracks if item.state is ObjectState.PERSON]
    if not people_m or not segment.detection.is_dynamic or state is ObjectState.MOVING:
        return segment
    gaps_m = np.linalg.norm((np.array(people_m) - segment.center_map_m)[:, :2], axis=1)
    if gaps_m.min() < REACH_M:
        return segment
    return segment._replace(detection=replace(segment.detection, state=ObjectState.AT_REST))


def _link(objects: Sequence[MappedObject], tracks: Sequence[TrackedObject]) -> None:
    by_class: dict[str, list[MappedObject]] = {}
    for item in objects:
        if item.is_present:
            by_class.setdefault(item.class_name, []).append(item)
    for track in tracks:
        near = by_class.get(track.class_name)
        if not track.state.is_at_rest or not near:
            continue
        distances_m = [_distance_m(item, track) for item in near]
        nearest = int(np.argmin(distances_m))
        if distances_m[nearest] < _SAME_M:
            near[nearest].track_id = track.track_id
            near[nearest].was_carried = track.state is ObjectState.MOVED


def _note_handled(
    item: MappedObject, track: TrackedObject, people: Sequence[TrackedObject], stamp_ns: int
) -> None:
    """Mark an object as HANDLED if its track is handled elsewhere and its place is seen empty.

    Its holder is the person nearest to the track, or -1 if nobody is within reach.
    """
    if track.state is not ObjectState.HANDLED or _distance_m(item, track) < _AWAY_M:
        return
    if item.evidence.num_through < _MIN_THROUGH or item.evidence.is_brief:
        return
    by_distance = [(track.distance_over_floor_m(person), person.track_id) for person in people]
    distance_m, person_id = min(by_distance, default=(np.inf, -1))
    item.leave(ObjectState.HANDLED, stamp_ns)
    item.holder_id = person_id if distance_m < REACH_M else -1


def _is_reliable(item: MappedObject) -> bool:
    """Return whether the sightings of an object prove that it was at rest at its place.

    Many sightings prove it. Few sightings, at least `_FEW_SIGHTINGS`, prove it if the object was
    detected in most of the images that showed its surface (`_STABLE_RATIO`), and has left since.
    """
    seen = item.evidence
    if not seen.is_brief:
        return True
    is_stable = seen.num_sightings >= max(_FEW_SIGHTINGS, _STABLE_RATIO * seen.num_visible)
    return is_stable and not item.is_present


def _join_order(item: MappedObject) -> tuple[bool, int]:
    """Return the sort key of the order in which old objects are matched with new objects.

    Objects seen often come first: an object with few sightings may have seemed to be at rest for a
    moment in somebody's hands. Among these, objects seen last come first.
    """
    return item.evidence.is_brief, -item.evidence.last_ns


def _may_be(item: MappedObject, other: MappedObject) -> bool:
    """Return whether `other` may be `item`, found again at another place.

    It must be of the same class and map, and seen for the first time after `item` was seen last.
    """
    return (
        other.evidence.first_ns > item.evidence.last_ns
        and other.object_id != item.object_id
        and other.class_name == item.class_name
        and other.map_id == item.map_id
    )


def _distance_m(item: MappedObject, track: TrackedObject) -> float:
    return float(np.linalg.norm(track.position_map_m - item.surface.center_map_m()))


def _is_elsewhere(
    track: TrackedObject | None, places: Sequence[MappedObject], stamp_ns: int
) -> bool:
    """Return whether a track was detected lately, away from the places of all objects given."""
    if track is None or track.stamp_ns <= stamp_ns - FRESH_NS:
        return False
    return all(_distance_m(item, track) >= _AWAY_M for item in places)


def _is_as_large(first: MappedObject, second: MappedObject) -> bool:
    """Return whether the sizes of two objects differ so little that they may be one object."""
    small, large = sorted((first.surface.radius_m(), second.surface.radius_m()))
    return large <= _MAX_RATIO * small
