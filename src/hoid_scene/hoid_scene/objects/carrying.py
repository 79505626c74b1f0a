"""Keeps the id of an object while a person carries it to another place.

The object tracker (`object_tracker`) follows an object while a person carries it. The map uses the
number of the object's track, which is the same at the old place and at the new one. Where the
track was lost on the way, the map uses what it knows of both places: the old one is seen without
the object, and a person was at the new one before the object was found there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S, FloatArray, ObjectState
from hoid_scene.objects.mapped_object import MappedObject
from hoid_scene.objects.segmentation import Segment
from hoid_scene.tracks.object_track import TrackedObject

# None of these numbers was tuned.
_SAME_M = 0.35  # a settled track nearer than this to an object is the object's track
_FRESH_NS = NS_PER_S // 2  # a track that was not detected for longer may be lost
_AWAY_M = 0.3  # an object is carried if its handled track is at least this far from its place
# Number of successive images that must show the old place empty before an object counts as
# handled.
_MIN_THROUGH = 2
# An object with fewer sightings cannot count as handled, and becomes another object only if its
# place was seen empty and no object with more sightings fits: a thing in somebody's hands may look
# at rest for a moment. Nor does it count as new in a loaded map: in three rearranged rooms, all
# wrong objects but one had at most five (`hoid bench rooms`, seeds 101 to 103).
_MIN_SIGHTINGS = 6
_FEW_SIGHTINGS = 4  # fewer do not show that an object was at rest; chosen on seeds 83 and 85
_STABLE_SHARE = 0.75  # of the looks at an object with few sightings, in which it must be detected
# Furniture that one person does not carry; chosen.
_HEAVY = frozenset({'couch', 'bed', 'dining table', 'refrigerator', 'oven', 'toilet', 'sink'})
# Number of successive images that must show the old place without a detection of the object, empty
# or not, before it may be an object that a person has put down elsewhere.
_MIN_ABSENT = 4
_HOLDER_M = 1.2  # largest horizontal distance from the track to the person who handles it
_ADOPT_NS = 600 * NS_PER_S  # an object that has left its place for longer gets a new number
# A person has put an object down if its track has settled, and the surface of the detection is
# nearer to the track than this; the filter may call it handled while the person is beside it. As
# long as such a track is handled within the second distance, the object is in somebody's hands,
# also if the filter calls it static.
_PUT_DOWN_M, _IN_HAND_M = 0.25, 0.5
# Largest ratio of the sizes of an object and of a new object that it may have become.
_MAX_RATIO = 1.6
# How long the places of people are remembered. An object that was not seen for longer may have
# been moved while no camera was watching.
_VISIT_NS = 60 * NS_PER_S
_EARLY_NS = NS_PER_S  # a person may hide an object for so long before it leaves its place


class _Visit(NamedTuple):
    """Where people were in one image."""

    stamp_ns: int
    positions_map_m: FloatArray  # (P, 3)


class Carrying:
    """Links tracks to objects of the map, and moves objects that were put down elsewhere."""

    def __init__(self) -> None:
        self._visits: deque[_Visit] = deque()

    def note_seen(self, item: MappedObject) -> None:
        """Record that an object was detected at its place: it is AT_REST or MOVED.

        If it had left its place, it has no holder any more.
        """
        if not item.is_present:
            item.state = ObjectState.AT_REST if item.moved_from_m is None else ObjectState.MOVED
            item.holder_id = -1

    def follow(
        self, objects: list[MappedObject], tracks: Sequence[TrackedObject], stamp_ns: int
    ) -> list[MappedObject]:
        """Update which objects people handle, and join objects with those that they have become.

        Args:
            objects: All objects of the map, which are changed.
            tracks: The tracks of people and objects at this time.
            stamp_ns: Time of the image.

        Returns:
            The objects without the new ones that turned out to be older ones that were carried.
        """
        self._note_people(tracks, stamp_ns)
        by_id = {track.track_id: track for track in tracks}
        self._link(objects, tracks)
        for item in objects:
            track = by_id.get(item.track_id)
            is_fixed = item.class_name in _HEAVY or not item.is_confirmed
            if track is not None and item.is_present and not is_fixed:
                self._note_handled(item, track, tracks, stamp_ns)
        return self._joined(objects, by_id, stamp_ns)

    def _note_people(self, tracks: Sequence[TrackedObject], stamp_ns: int) -> None:
        """Remember where people are, for a minute."""
        at = [track.position_map_m for track in tracks if track.state is ObjectState.PERSON]
        if at:
            self._visits.append(_Visit(stamp_ns, np.array(at)))
        while self._visits and not 0 <= stamp_ns - self._visits[0].stamp_ns <= _VISIT_NS:
            self._visits.popleft()

    def _link(self, objects: Sequence[MappedObject], tracks: Sequence[TrackedObject]) -> None:
        """Give each settled track to the nearest object of its class that is at rest there."""
        by_class: dict[str, list[MappedObject]] = {}
        for item in objects:
            if item.is_present:
                by_class.setdefault(item.class_name, []).append(item)
        centers_m = {
            name: np.array([item.center_map_m() for item in items])
            for name, items in by_class.items()
        }
        for track in tracks:
            near = by_class.get(track.class_name)
            if not track.state.is_at_rest or not near:
                continue
            distances_m = np.linalg.norm(
                centers_m[track.class_name] - track.position_map_m, axis=1
            )
            nearest = int(np.argmin(distances_m))
            if distances_m[nearest] < _SAME_M:
                near[nearest].track_id = track.track_id
                near[nearest].was_carried = track.state is ObjectState.MOVED

    def _note_handled(
        self,
        item: MappedObject,
        track: TrackedObject,
        tracks: Sequence[TrackedObject],
        stamp_ns: int,
    ) -> None:
        """Mark an object as HANDLED if its track is handled elsewhere and its place is seen empty.

        Its holder is the person nearest to the track, or -1 if nobody is within 1.2 m.

        Args:
            item: The object, which is at rest according to the map.
            track: Its track.
            tracks: All tracks, of which those of people are used.
            stamp_ns: Time of the image.
        """
        if track.state is not ObjectState.HANDLED or not _is_away(item, track):
            return
        if item.num_through < _MIN_THROUGH or is_brief(item):
            return
        people = [
            (float(np.linalg.norm((p.position_map_m - track.position_map_m)[:2])), p.track_id)
            for p in tracks
            if p.state is ObjectState.PERSON
        ]
        distance_m, person_id = min(people, default=(np.inf, -1))
        item.leave(ObjectState.HANDLED, stamp_ns)
        item.holder_id = person_id if distance_m < _HOLDER_M else -1

    def _joined(
        self, objects: list[MappedObject], tracks: dict[int, TrackedObject], stamp_ns: int
    ) -> list[MappedObject]:
        """Move each object that has left its place to that of the new object that it has become.

        Return the objects without these new ones.

        Args:
            objects: All objects.
            tracks: The tracks by number.
            stamp_ns: Time of the image.
        """
        new = [item for item in objects if item.is_present and item.is_confirmed]
        removed: set[int] = set()
        for item in sorted(objects, key=_join_order):
            is_fixed = item.class_name in _HEAVY and not item.is_loaded
            if is_fixed or not item.is_confirmed or item.object_id in removed:
                continue
            fitting = [
                (rank, other.first_ns, other.object_id, other)
                for other in new
                if other.object_id not in removed
                and (rank := self._evidence(item, other, tracks, stamp_ns)) > 0
            ]
            if fitting:
                *_, found = min(fitting, key=lambda row: (-row[0], *row[1:3]))
                item.move_to(found)
                removed.add(found.object_id)
        return [item for item in objects if item.object_id not in removed]

    def _evidence(
        self,
        item: MappedObject,
        other: MappedObject,
        tracks: dict[int, TrackedObject],
        stamp_ns: int,
    ) -> int:
        """Return how strong the evidence is that an object has become another one; 0: none.

        The other one must be of the same class and must have been seen first after the last
        sighting of `item`. The evidence, from the strongest on, is the same track; a place seen
        without `item` and an object that was carried to its place; and an empty place and a person
        who was at the new one since, or nobody watching for a minute.

        Args:
            item: A confirmed object, which may have been carried away.
            other: A confirmed object at rest.
            tracks: The tracks by number.
            stamp_ns: Time of the image.
        """
        if not _may_be(item, other) or not _is_reliable(item):
            return 0
        is_same_track = item.track_id == other.track_id != -1
        has_left = item.state is ObjectState.HANDLED or item.num_through >= _MIN_THROUGH
        if is_same_track and (other.was_carried or has_left):
            return 3
        track = tracks.get(item.track_id)
        if not _is_as_large(item, other) or _is_elsewhere(track, (item, other), stamp_ns):
            return 0
        if other.was_carried and (item.num_absent >= _MIN_ABSENT or not item.is_present):
            return 2
        if item.is_present or stamp_ns - item.left_ns > _ADOPT_NS:
            return 0
        is_long_ago = item.is_loaded or other.first_ns - item.last_ns > _VISIT_NS
        return int(is_long_ago or self._was_visited(other, item.last_ns - _EARLY_NS))

    def _was_visited(self, item: MappedObject, since_ns: int) -> bool:
        """Return whether a person was within reach of an object before it was found."""
        at = [
            visit.positions_map_m
            for visit in self._visits
            if since_ns <= visit.stamp_ns <= item.first_ns
        ]
        if not at:
            return False
        offsets_m = (np.concatenate(at) - item.center_map_m())[:, :2]
        return bool(np.linalg.norm(offsets_m, axis=1).min() < _HOLDER_M)


def is_brief(item: MappedObject) -> bool:
    """Return whether an object was seen too rarely to count as handled, or as new in a map."""
    return item.num_sightings < _MIN_SIGHTINGS


def _is_reliable(item: MappedObject) -> bool:
    """Return whether an object was at rest at its place, as far as its sightings show.

    One with few sightings was, if it was detected in nearly each look at it until it left.
    """
    if not is_brief(item):
        return True
    is_stable = item.num_sightings >= max(_FEW_SIGHTINGS, _STABLE_SHARE * item.num_visible)
    return is_stable and not item.is_present


def _join_order(item: MappedObject) -> tuple[bool, int]:
    """Return the sort key of the order in which objects may become new ones.

    Those that were seen often come first: an object with few sightings may be a thing that seemed
    to be at rest in somebody's hands for a moment. Then those that were seen last come first.
    """
    return is_brief(item), -item.last_ns


def _may_be(item: MappedObject, other: MappedObject) -> bool:
    """Return whether the second object has the first one's class and was first seen after it."""
    return (
        other.first_ns > item.last_ns
        and other.object_id != item.object_id
        and other.class_name == item.class_name
        and other.place.map_id == item.place.map_id
    )


def _is_away(item: MappedObject, track: TrackedObject) -> bool:
    """Return whether a track is at another place than an object of the map."""
    offset_m = np.linalg.norm(track.position_map_m - item.center_map_m())
    return bool(offset_m >= _AWAY_M)


def _is_elsewhere(
    track: TrackedObject | None, places: Sequence[MappedObject], stamp_ns: int
) -> bool:
    """Return whether a track was seen lately away from the places of all these objects."""
    if track is None or track.stamp_ns <= stamp_ns - _FRESH_NS:
        return False
    return all(_is_away(item, track) for item in places)


def _is_as_large(first: MappedObject, second: MappedObject) -> bool:
    """Return whether the sizes of two objects differ so little that they may be one object."""
    small, large = sorted((first.radius_m(), second.radius_m()))
    return large <= _MAX_RATIO * small


def is_at_rest(segment: Segment, tracks: Sequence[TrackedObject], stamp_ns: int) -> bool:
    """Return whether the object of a segment is at rest, by its track or the filter's verdict.

    The nearest handled or put-down track of its class decides, if one was detected near it lately;
    a handled one only if a person is within reach, because tracks may stay handled for long after
    the object was put down. Otherwise the verdict does.
    """
    center_m = segment.center_map_m
    near = [
        (float(np.linalg.norm(track.position_map_m - center_m)), track.state is ObjectState.MOVED)
        for track in tracks
        if track.state in (ObjectState.HANDLED, ObjectState.MOVED)
        and track.class_name == segment.detection.class_name
        and track.stamp_ns > stamp_ns - _FRESH_NS
    ]
    distance_m, is_put_down = min(near, default=(np.inf, False))
    if is_put_down and distance_m < _PUT_DOWN_M:
        return True
    if not is_put_down and distance_m < _IN_HAND_M and _has_holder(center_m, tracks):
        return False
    return not segment.detection.is_dynamic


def _has_holder(position_map_m: FloatArray, tracks: Sequence[TrackedObject]) -> bool:
    """Return whether a person is within reach of a point (3,)."""
    return any(
        float(np.linalg.norm((track.position_map_m - position_map_m)[:2])) < _HOLDER_M
        for track in tracks
        if track.state is ObjectState.PERSON
    )
