"""Keeps the id of an object while a person carries it to another place.

The object tracker (`object_tracker`) follows an object while a person carries it. The map uses the
number of the object's track, which is the same at the old place and at the new one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_common.values import NS_PER_S
from rgbd_slam.scene.object_track import SETTLED, ObjectState, TrackedObject
from rgbd_slam.scene.objects.mapped_object import MappedObject, PlaceState

# None of these numbers was tuned.
_SAME_M = 0.35  # a settled track nearer than this to an object is the object's track
_AWAY_M = 0.3  # an object is carried if its handled track is at least this far from its place
# Number of successive images that must show the old place empty before an object counts as
# handled.
_MIN_THROUGH = 2
_HOLDER_M = 1.2  # largest horizontal distance from the track to the person who handles it
_ADOPT_NS = 600 * NS_PER_S  # an object that has left its place for longer gets a new number
# Largest ratio of the sizes of an object of a loaded map and of a new object that it may have
# become: it may have been moved while nobody watched.
_MAX_RATIO = 1.6


class Carrying:
    """Links tracks to objects of the map, and moves objects that were put down elsewhere."""

    def note_seen(self, item: MappedObject) -> None:
        """Record that an object was detected at its place: it is AT_REST or MOVED.

        If it had left its place, it has no holder any more.
        """
        if not item.is_present:
            item.state = PlaceState.AT_REST if item.moved_from_m is None else PlaceState.MOVED
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
        by_id = {track.track_id: track for track in tracks}
        self._link(objects, tracks)
        for item in objects:
            track = by_id.get(item.track_id)
            if track is not None and item.is_present and item.is_confirmed:
                self._note_handled(item, track, tracks, stamp_ns)
        return self._joined(objects, stamp_ns)

    def _link(self, objects: Sequence[MappedObject], tracks: Sequence[TrackedObject]) -> None:
        """Give objects at rest the number of a settled track of their class at their place."""
        of_class: dict[str, list[TrackedObject]] = {}
        for track in tracks:
            if track.state in SETTLED:
                of_class.setdefault(track.class_name, []).append(track)
        for item in objects:
            settled = of_class.get(item.class_name)
            if settled is None or not item.is_present:
                continue
            offsets_m = np.array([track.position_map_m for track in settled]) - item.center_map_m()
            distances_m = np.linalg.norm(offsets_m, axis=1)
            nearest = int(np.argmin(distances_m))
            if distances_m[nearest] < _SAME_M:
                item.track_id = settled[nearest].track_id

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
        away_m = np.linalg.norm(track.position_map_m - item.center_map_m())
        if track.state is not ObjectState.HANDLED or away_m < _AWAY_M:
            return
        if item.num_through < _MIN_THROUGH:
            return
        people = [
            (float(np.linalg.norm((p.position_map_m - track.position_map_m)[:2])), p.track_id)
            for p in tracks
            if p.state is ObjectState.PERSON
        ]
        distance_m, person_id = min(people, default=(np.inf, -1))
        item.leave(PlaceState.HANDLED, stamp_ns)
        item.holder_id = person_id if distance_m < _HOLDER_M else -1

    def _joined(self, objects: list[MappedObject], stamp_ns: int) -> list[MappedObject]:
        """Move each object that has left its place to that of the new object that it has become.

        Return the objects without these new ones.
        """
        removed: set[int] = set()
        away = [item for item in objects if not item.is_present and item.is_confirmed]
        for item in sorted(away, key=lambda item: -item.last_ns):
            new = self._put_down(item, objects, removed, stamp_ns)
            if new is not None:
                item.move_to(new)
                removed.add(new.object_id)
        return [item for item in objects if item.object_id not in removed]

    def _put_down(
        self,
        item: MappedObject,
        objects: Sequence[MappedObject],
        removed: set[int],
        stamp_ns: int,
    ) -> MappedObject | None:
        """Return the new object that an object which has left its place has become, or None.

        It is confirmed, at rest, of the same class and was first seen after the last sighting of
        `item`, which must have left its place at most 600 s ago. If `item` is from a loaded map,
        both must be about as large. One with the same track is preferred, and among several the
        one that was seen first.

        Args:
            item: The object that has left its place.
            objects: All objects.
            removed: Ids of new objects that others have become already.
            stamp_ns: Time of the image.
        """
        if stamp_ns - item.left_ns > _ADOPT_NS:
            return None
        fitting = [
            other
            for other in objects
            if other.is_present
            and other.is_confirmed
            and other.object_id not in removed
            and other.class_name == item.class_name
            and other.first_ns > item.last_ns
            and (not item.is_loaded or _is_as_large(item, other))
        ]
        same = [other for other in fitting if other.track_id == item.track_id != -1]
        found = same or fitting
        return min(found, key=lambda other: other.first_ns, default=None)


def _is_as_large(first: MappedObject, second: MappedObject) -> bool:
    """Return whether the sizes of two objects differ so little that they may be one object."""
    small, large = sorted((first.radius_m(), second.radius_m()))
    return large <= _MAX_RATIO * small
