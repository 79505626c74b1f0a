"""Keeps the id of an object while a person carries it to another place.

The tracker of the present (`object_tracker`) follows an object from hand to hand; the map takes
from it only the number of its track, which is the same at the old place and at the new one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_common.values import NS_PER_S
from rgbd_slam.scene.object_track import SETTLED, ObjectState, TrackedObject
from rgbd_slam.scene.objects.mapped_object import MappedObject, PlaceState

# None of these numbers was tuned.
_SAME_M = 0.35  # a track nearer to an object is a track of the object
_AWAY_M = 0.3  # a track farther away from its object carries it
_MIN_THROUGH = 2  # looks through the old place that confirm that somebody handles an object
_HOLDER_M = 1.2  # a person farther away does not handle it
_ADOPT_NS = 600 * NS_PER_S  # time after which an object that is gone gets a new number
# Largest ratio of the sizes of an object of a loaded map and of one that it may have become, as
# nobody saw it moved.
_MAX_RATIO = 1.6


class Carrying:
    """Links tracks to objects of the map, and moves objects that were put down again."""

    def note_seen(self, item: MappedObject) -> None:
        """Note a detection of an object at its known place: nobody has taken it away."""
        if not item.is_present:
            item.state = PlaceState.AT_REST if item.moved_from_m is None else PlaceState.MOVED
            item.holder_id = -1

    def follow(
        self, objects: list[MappedObject], tracks: Sequence[TrackedObject], stamp_ns: int
    ) -> list[MappedObject]:
        """Update what people handle; return the objects without those that were the same."""
        by_id = {track.track_id: track for track in tracks}
        self._link(objects, tracks)
        for item in objects:
            track = by_id.get(item.track_id)
            if track is not None and item.is_present and item.is_confirmed:
                self._note_handled(item, track, tracks, stamp_ns)
        return self._joined(objects, stamp_ns)

    def _link(self, objects: Sequence[MappedObject], tracks: Sequence[TrackedObject]) -> None:
        """Give each object the number of the settled track at its place."""
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
        """Mark an object whose track a person moves away while its place is seen empty."""
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
        """Move each object that is away to the new object that it has become."""
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
        """Return the object that a carried one has become, or None."""
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
    """Return whether two objects may be one, by their measured sizes."""
    small, large = sorted((first.radius_m(), second.radius_m()))
    return large <= _MAX_RATIO * small
