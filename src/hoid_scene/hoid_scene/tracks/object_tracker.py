"""Tracks people and objects in the map frame, for planners that keep a distance to them.

A box that overlaps the box of a person often belongs to an object far behind the person, so that
the filter calls an object dynamic that is at rest. The depth image is therefore compared with the
object's track first: an object that is still visible at the depth of its place of rest stays at
rest, and an object that a person occludes keeps its track unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hoid_common.values import NS_PER_S, PERSON, S_PER_NS, DynamicObject, FloatArray, ObjectState
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.grid.floor import Floor
from hoid_scene.tracks.object_sighting import DepthImage, Sighting, measure
from hoid_scene.tracks.object_track import FRESH_NS, REACH_M, KalmanTrack, TrackedObject

# None of these numbers was tuned.
_OCCLUDED_M = 0.15  # a surface this far in front of an object's place occludes the object
_GONE_M = 0.25  # a surface this far behind an object's place shows that the object is gone
# How far a person may carry an object while it is not detected: speed [m/s] and longest time [s].
_CARRY_MPS, _CARRY_S = 1.5, 3.0
# An object detected within this distance [m] of a handled track, with a person within reach, is in
# that person's hands.
_IN_HAND_M = 0.5


class ObjectTracker:
    """Associates the classified detections of each image with the tracks of people and objects."""

    def __init__(self, config: ObjectTrackerConfig) -> None:
        self._config = config
        self._tracks: list[KalmanTrack] = []
        self._next_id = 0

    def update(
        self,
        objects: Sequence[DynamicObject],
        image: DepthImage,
        stamp_ns: int,
        floor: Floor | None = None,
    ) -> tuple[TrackedObject, ...]:
        """Update the tracks with the detections of one image; return the confirmed tracks by id.

        Images must come in order of time.
        """
        free = [track for track in self._tracks if not track.is_taken]
        people_m: list[FloatArray] = []
        for detection in sorted(filter(_is_measured, objects), key=_priority):
            known = self._track_in_box(detection, image, free, stamp_ns)
            known_m = None if known is None else known.position_at_m(stamp_ns)
            sighting = measure(detection, image, known_m, floor)
            if sighting is None:
                continue
            if detection.class_name == PERSON:
                people_m.append(sighting.position_map_m)
            elif known is not None and known.state.is_at_rest and detection.is_dynamic:
                # The filter calls the object dynamic, because its box overlaps the box of a
                # person. The object may be at rest behind the person nevertheless.
                if sighting.is_at_known_depth:
                    free.remove(known)
                    known.confirm(sighting, stamp_ns)
                    continue
                if _is_occluded(sighting, image, known_m):
                    continue
            self._assign(sighting, free, people_m, image, stamp_ns)
        self._mark_gone(free, image)
        self._tracks = self._alive(stamp_ns)
        confirmed = [track for track in self._tracks if track.is_confirmed]
        confirmed.sort(key=lambda track: track.track_id)
        return tuple(track.value_at(stamp_ns) for track in confirmed)

    def judged(
        self, objects: Sequence[DynamicObject], image: DepthImage, stamp_ns: int
    ) -> tuple[DynamicObject, ...]:
        """Return the detections with the states that the tracks give them.

        The filter uses one image only. It may report HANDLED for an object behind a person or one
        that was put down, and AT_REST for an object that a person holds still. A detection is at
        rest if enough of its box is at the depth of the place of a settled track of its class that
        was detected lately. It is HANDLED near a handled track of its class that was detected
        lately, if a person is within reach. Otherwise it keeps the filter's verdict.
        """
        fresh = [
            track
            for track in self._tracks
            if track.is_confirmed and stamp_ns - track.stamp_ns < FRESH_NS
        ]
        return tuple(
            replace(item, state=self._state_of(item, image, fresh, stamp_ns)) for item in objects
        )

    def _state_of(
        self, item: DynamicObject, image: DepthImage, fresh: list[KalmanTrack], stamp_ns: int
    ) -> ObjectState:
        if item.class_name == PERSON or not _is_measured(item):
            return item.state
        if item.is_dynamic:
            settled = [track for track in fresh if track.state.is_at_rest]
            known = self._track_in_box(item, image, settled, stamp_ns)
            known_m = None if known is None else known.position_at_m(stamp_ns)
            seen = None if known_m is None else measure(item, image, known_m, None)
            is_there = seen is not None and seen.is_at_known_depth
            return known.state if known is not None and is_there else item.state
        handled = [
            track
            for track in fresh
            if track.state is ObjectState.HANDLED and track.class_name == item.class_name
        ]
        seen = measure(item, image, None, None) if handled else None
        if seen is None:
            return item.state
        people_m = [
            track.position_at_m(stamp_ns) for track in fresh if track.state is ObjectState.PERSON
        ]
        gaps_m = [track.position_at_m(stamp_ns) - seen.position_map_m for track in handled]
        is_near = min(float(np.linalg.norm(gap_m)) for gap_m in gaps_m) < _IN_HAND_M
        return ObjectState.HANDLED if is_near and _in_reach(seen, people_m) else item.state

    def _track_in_box(
        self, detection: DynamicObject, image: DepthImage, free: list[KalmanTrack], stamp_ns: int
    ) -> KalmanTrack | None:
        """Return the track whose predicted pixel is nearest to the center of a detection's box.

        Only tracks in `free` of the same class, whose predicted pixel is inside the box, are
        considered. None is returned without such a track.
        """
        x1, y1, x2, y2 = detection.box_xyxy_px
        center = np.array([(x1 + x2) / 2, (y1 + y2) / 2])
        best, best_px = None, np.inf
        for track in free:  # fast enough for few tracks
            if track.class_name != detection.class_name:
                continue
            uv = image.pixel_of(track.position_at_m(stamp_ns))
            if uv is None or not (x1 <= uv[0] < x2 and y1 <= uv[1] < y2):
                continue
            offset_px = float(np.linalg.norm(uv - center))
            if offset_px < best_px:
                best, best_px = track, offset_px
        return best

    def _assign(
        self,
        sighting: Sighting,
        free: list[KalmanTrack],
        people_m: list[FloatArray],
        image: DepthImage,
        stamp_ns: int,
    ) -> None:
        """Update the track that a sighting belongs to, or start a new one.

        A handled object out of every person's reach starts no track. If an object of the same
        class was taken away, its track is continued instead of starting a new one.
        """
        match = self._carried_here(sighting, free, image, stamp_ns)
        match = match or self._nearest(sighting, free, stamp_ns)
        if match is not None:
            free.remove(match)
            match.correct(sighting, stamp_ns)
            return
        detection = sighting.detection
        if _is_handled(detection) and not _in_reach(sighting, people_m):
            return  # its box overlaps a person's box, but no person can reach it
        taken = self._last_taken(detection.class_name)
        if taken is not None:
            taken.put_down(sighting, stamp_ns)
            return
        self._next_id += 1
        self._tracks.append(KalmanTrack(self._next_id, sighting, stamp_ns, self._config))

    def _nearest(
        self, sighting: Sighting, free: list[KalmanTrack], stamp_ns: int
    ) -> KalmanTrack | None:
        best, best_m = None, self._config.gate_m
        for track in free:  # fast enough for few tracks
            if track.class_name != sighting.detection.class_name:
                continue
            offset = track.position_at_m(stamp_ns) - sighting.position_map_m
            distance_m = float(np.linalg.norm(offset))
            rests = track.state.is_at_rest and not sighting.detection.is_dynamic
            if distance_m < min(best_m, self._config.rest_gate_m if rests else np.inf):
                best, best_m = track, distance_m
        return best

    def _carried_here(
        self, sighting: Sighting, free: list[KalmanTrack], image: DepthImage, stamp_ns: int
    ) -> KalmanTrack | None:
        """Return the confirmed track of an object that a person can have carried to a sighting.

        It is the nearest such track of the sighting's class in `free`. The predicted place of the
        object must be in view, where no detection was assigned to it. None is returned if there is
        no such track, or if the sighting is not of a handled object.
        """
        if not _is_handled(sighting.detection):
            return None
        best, best_m = None, np.inf
        for track in free:  # fast enough for few tracks
            if track.class_name != sighting.detection.class_name or not track.is_confirmed:
                continue
            unseen_s = min((stamp_ns - track.stamp_ns) * S_PER_NS, _CARRY_S)
            place_m = track.position_at_m(stamp_ns)
            distance_m = float(np.linalg.norm(place_m - sighting.position_map_m))
            reach_m = self._config.gate_m + _CARRY_MPS * unseen_s
            if distance_m < min(best_m, reach_m) and image.has_in_view(place_m):
                best, best_m = track, distance_m
        return best

    def _last_taken(self, class_name: str) -> KalmanTrack | None:
        taken = [t for t in self._tracks if t.is_taken and t.class_name == class_name]
        return max(taken, key=lambda track: track.stamp_ns, default=None)

    def _mark_gone(self, unseen: list[KalmanTrack], image: DepthImage) -> None:
        for track in unseen:
            if track.state.is_at_rest and image.sees_through(track.position_at_m(0), _GONE_M):
                track.count_seen_through()

    def _alive(self, stamp_ns: int) -> list[KalmanTrack]:
        limit_ns = self._config.forget_moving_s * NS_PER_S
        for track in self._tracks:
            is_late = stamp_ns - track.stamp_ns > limit_ns
            if track.state is ObjectState.HANDLED and is_late and track.was_at_rest:
                track.is_taken = True
        alive = [track for track in self._tracks if track.is_alive(stamp_ns)]
        alive.sort(key=lambda track: track.stamp_ns)
        return alive[-self._config.max_objects :]


def _in_reach(sighting: Sighting, people_m: list[FloatArray]) -> bool:
    return any(
        np.linalg.norm((person_m - sighting.position_map_m)[:2]) < REACH_M for person_m in people_m
    )


def _is_measured(item: DynamicObject) -> bool:
    """Return whether a detection is of a person, or its box is of this image and not predicted.

    A box that was predicted from older images does not show where an object is.
    """
    return item.class_name == PERSON or item.state is not ObjectState.PREDICTED


def _is_handled(item: DynamicObject) -> bool:
    """Return whether the filter reports that a person handles or has just handled the object.

    Objects that were noticed by their motion only may move by themselves.
    """
    return item.class_name != PERSON and item.is_dynamic and item.state is not ObjectState.MOVING


def _priority(item: DynamicObject) -> tuple[bool, bool]:
    """Return a sort key: people, then objects at rest, which keep tracks, then handled ones."""
    return item.class_name != PERSON, item.is_dynamic


def _is_occluded(sighting: Sighting, image: DepthImage, known_m: FloatArray | None) -> bool:
    """Return whether a sighting is over 0.15 m nearer to the camera than the known place."""
    if known_m is None:
        return False
    layer_m = image.depth_of_m(sighting.position_map_m)
    return layer_m < image.depth_of_m(known_m) - _OCCLUDED_M
