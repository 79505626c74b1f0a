"""People and handled objects as tracks in the map frame, for planners that keep their distance.

A detector sees boxes, and a box over a person is often an object far behind. So each box is
measured on the depth image, and what is known is asked first: an object whose place still shows
it is at rest, one that a person hides is neither seen nor gone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_common.values import NS_PER_S, PERSON, S_PER_NS, DynamicObject, FloatArray, Reason
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.scene.floor import Floor
from rgbd_slam.scene.object_sighting import DepthScene, Sighting, sight
from rgbd_slam.scene.object_track import KalmanTrack, ObjectState, TrackedObject

__all__ = ['ObjectState', 'ObjectTracker', 'TrackedObject']

_HIDDEN_M = 0.15  # what shows so much before an object's place hides it
_GONE_M = 0.25  # what shows so far behind it means that it is gone
_CARRY_MPS, _CARRY_S = 1.5, 3.0  # how fast, and for how long unseen, an object is carried


class ObjectTracker:
    """Turns per-frame verdicts into tracks."""

    def __init__(self, config: ObjectTrackerConfig) -> None:
        self._config = config
        self._tracks: list[KalmanTrack] = []
        self._next_id = 0

    def update(
        self,
        objects: Sequence[DynamicObject],
        scene: DepthScene,
        stamp_ns: int,
        floor: Floor | None = None,
    ) -> tuple[TrackedObject, ...]:
        """Take one image's objects; return all confirmed tracks in rising order of id.

        Args:
            objects: The filter's verdicts.
            scene: The depth image and where it was taken, in a map with z up.
            floor: Of the room, when known.
        """
        free = [track for track in self._tracks if not track.is_taken]
        people_m: list[FloatArray] = []
        for seen in sorted(filter(_is_seen, objects), key=_turn):
            known = self._track_in_box(seen, scene, free, stamp_ns)
            known_m = None if known is None else known.position_at_m(stamp_ns)
            sighting = sight(seen, scene, known_m, floor)
            if sighting is None:
                continue
            if seen.class_name == PERSON:
                people_m.append(sighting.position_map_m)
            elif known is not None and known.is_settled and seen.is_dynamic:
                # A box that overlaps a person's: is the object still where it rests?
                if sighting.is_known:
                    free.remove(known)
                    known.confirm(sighting, stamp_ns)
                    continue
                if _is_hidden(sighting, scene, known_m):
                    continue
            self._assign(sighting, free, people_m, scene, stamp_ns)
        self._look_for_gone(free, scene)
        self._tracks = self._alive(stamp_ns)
        confirmed = [track for track in self._tracks if track.is_confirmed]
        confirmed.sort(key=lambda track: track.track_id)
        return tuple(track.value_at(stamp_ns) for track in confirmed)

    def clear(self) -> None:
        """Forget all tracks."""
        self._tracks = []

    def _track_in_box(
        self, seen: DynamicObject, scene: DepthScene, free: list[KalmanTrack], stamp_ns: int
    ) -> KalmanTrack | None:
        """Return the track of the class that should be in the box, nearest to its middle."""
        x1, y1, x2, y2 = seen.box_xyxy_px
        middle = np.array([(x1 + x2) / 2, (y1 + y2) / 2])
        best, best_px = None, np.inf
        for track in free:  # a handful
            if track.class_name != seen.class_name:
                continue
            uv = scene.pixel_of(track.position_at_m(stamp_ns))
            if uv is None or not (x1 <= uv[0] < x2 and y1 <= uv[1] < y2):
                continue
            offset_px = float(np.linalg.norm(uv - middle))
            if offset_px < best_px:
                best, best_px = track, offset_px
        return best

    def _assign(
        self,
        sighting: Sighting,
        free: list[KalmanTrack],
        people_m: list[FloatArray],
        scene: DepthScene,
        stamp_ns: int,
    ) -> None:
        """Give a sighting to the nearest free track, or start one."""
        match = self._carried_here(sighting, free, scene, stamp_ns)
        match = match or self._nearest(sighting, free, stamp_ns)
        if match is not None:
            free.remove(match)
            match.correct(sighting, stamp_ns)
            return
        seen = sighting.seen
        if _is_handled(seen) and not self._in_reach(sighting, people_m):
            return  # a box before or behind a person, not in anybody's hands
        taken = self._last_taken(seen.class_name)
        if taken is not None:
            taken.put_down(sighting, stamp_ns)
            return
        self._next_id += 1
        self._tracks.append(KalmanTrack(self._next_id, sighting, stamp_ns, self._config))

    def _nearest(
        self, sighting: Sighting, free: list[KalmanTrack], stamp_ns: int
    ) -> KalmanTrack | None:
        best, best_m = None, self._config.gate_m
        for track in free:  # a handful
            if track.class_name != sighting.seen.class_name:
                continue
            offset = track.position_at_m(stamp_ns) - sighting.position_map_m
            distance_m = float(np.linalg.norm(offset))
            rests = track.is_settled and not sighting.seen.is_dynamic
            if distance_m < min(best_m, self._config.rest_gate_m if rests else np.inf):
                best, best_m = track, distance_m
        return best

    def _carried_here(
        self, sighting: Sighting, free: list[KalmanTrack], scene: DepthScene, stamp_ns: int
    ) -> KalmanTrack | None:
        """Return the known object that somebody can have carried here while it was unseen.

        It was published, and its last place is in view and does not show it any more.
        """
        if not _is_handled(sighting.seen):
            return None
        best, best_m = None, np.inf
        for track in free:  # a handful
            if track.class_name != sighting.seen.class_name or not track.is_confirmed:
                continue
            unseen_s = min((stamp_ns - track.stamp_ns) * S_PER_NS, _CARRY_S)
            place_m = track.position_at_m(stamp_ns)
            distance_m = float(np.linalg.norm(place_m - sighting.position_map_m))
            reach_m = self._config.gate_m + _CARRY_MPS * unseen_s
            if distance_m < min(best_m, reach_m) and scene.has_in_view(place_m):
                best, best_m = track, distance_m
        return best

    def _in_reach(self, sighting: Sighting, people_m: list[FloatArray]) -> bool:
        return any(
            np.linalg.norm((person_m - sighting.position_map_m)[:2]) < self._config.reach_m
            for person_m in people_m
        )

    def _last_taken(self, class_name: str) -> KalmanTrack | None:
        taken = [t for t in self._tracks if t.is_taken and t.class_name == class_name]
        return max(taken, key=lambda track: track.stamp_ns, default=None)

    def _look_for_gone(self, unseen: list[KalmanTrack], scene: DepthScene) -> None:
        """Mark the resting objects whose place shows what is behind it."""
        for track in unseen:
            if track.is_settled and scene.sees_through(track.position_at_m(0), _GONE_M):
                track.look_through()

    def _alive(self, stamp_ns: int) -> list[KalmanTrack]:
        limit_ns = self._config.forget_moving_s * NS_PER_S
        for track in self._tracks:
            is_late = stamp_ns - track.stamp_ns > limit_ns
            if track.state is ObjectState.HANDLED and is_late and track.was_at_rest:
                track.take_away()
        alive = [track for track in self._tracks if track.is_alive(stamp_ns)]
        alive.sort(key=lambda track: track.stamp_ns)
        return alive[-self._config.max_objects :]


def _is_seen(item: DynamicObject) -> bool:
    """Return whether a box was seen; a predicted one says nothing of where an object is."""
    return item.class_name == PERSON or item.reason is not Reason.PREDICTED


def _is_handled(item: DynamicObject) -> bool:
    """Return whether somebody moves it; what moves undetected may do so by itself."""
    return item.class_name != PERSON and item.is_dynamic and item.reason is not Reason.MOVING


def _turn(item: DynamicObject) -> tuple[bool, bool]:
    """Return what puts people first, then what rests, which keeps its track, then the handled."""
    return item.class_name != PERSON, item.is_dynamic


def _is_hidden(sighting: Sighting, scene: DepthScene, known_m: FloatArray | None) -> bool:
    """Return whether something before the place where an object rests shows in its stead."""
    if known_m is None:
        return False
    layer_m = scene.depth_of_m(sighting.position_map_m)
    return layer_m < scene.depth_of_m(known_m) - _HIDDEN_M
