"""People and handled objects as tracks in the map frame, for planners that keep their distance.

Each track is a constant-velocity Kalman filter with one variance for all axes (Bar-Shalom et al.,
Estimation with Applications to Tracking and Navigation, 2001, sec. 6.2); association is greedy by
distance within a class.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from hoid_common import se3
from hoid_common.config import Config, param
from hoid_common.values import PERSON, DynamicObject, FloatArray, Reason


class ObjectState(Enum):
    """What is known of an object; the values are those of hoid_msgs/TrackedObject."""

    PERSON = 0
    HANDLED = 1
    AT_REST = 2  # where it was first seen
    MOVED = 3  # put down in another place


@dataclass(frozen=True)
class ObjectTrackerConfig(Config):
    """Tracking of people and objects in the map frame."""

    gate_m: float = param(0.7, 'A detection farther from a track starts a new one.', minimum=0.05)
    measurement_sigma_m: float = param(0.08, 'Noise of a measured centre.', minimum=0.001)
    acceleration_sigma_mps2: float = param(3.0, 'How abruptly people move.', minimum=0.01)
    forget_moving_s: float = param(1.5, 'Unseen people and handled objects end.', minimum=0.1)
    forget_resting_s: float = param(600.0, 'Unseen resting objects end.', minimum=1.0)
    rest_s: float = param(0.5, 'Seen still for so long, an object is at rest.', minimum=0.0)
    moved_m: float = param(0.15, 'Put down farther away than this, it was moved.', minimum=0.01)
    min_sightings: int = param(3, 'Sightings before a track is published.', minimum=1)
    person_depth_m: float = param(
        0.12, "From the surface of a person to the body's centre.", minimum=0.0, maximum=0.5
    )
    max_objects: int = param(200, 'Memory bound.', minimum=1)


@dataclass(frozen=True, eq=False)
class TrackedObject:
    """One person or object in the map frame."""

    track_id: int
    class_name: str
    state: ObjectState
    stamp_ns: int  # of the last sighting
    position_map_m: FloatArray  # (3,)
    velocity_map_mps: FloatArray  # (3,); zero at rest
    size_m: tuple[float, float]  # width, height as seen; NaN when unknown


@dataclass(frozen=True, eq=False)
class _Track:
    seen: TrackedObject
    covariance: FloatArray  # (2, 2) of position and velocity along any one axis
    rest_place_m: FloatArray  # (3,): where it rests or was picked up
    still_since_ns: int
    num_sightings: int


class ObjectTracker:
    """Turns per-frame verdicts into tracks."""

    def __init__(self, config: ObjectTrackerConfig) -> None:
        self._config = config
        self._tracks: list[_Track] = []
        self._next_id = 0

    def update(
        self, objects: Sequence[DynamicObject], T_map_camera: FloatArray, stamp_ns: int
    ) -> tuple[TrackedObject, ...]:
        """Take one frame's objects, centres in the camera frame; return all confirmed tracks."""
        tracks = [self._predict(track, stamp_ns) for track in self._tracks]
        stored = list(self._tracks)  # unseen tracks keep their last sighting to predict from
        free = set(range(len(tracks)))
        for seen in objects:
            if not np.isfinite(seen.center_camera_m).all():
                continue
            position_m = self._center_map_m(seen, T_map_camera)
            match = self._nearest(tracks, free, seen.class_name, position_m)
            if match is None:
                stored.append(self._start(seen, position_m, stamp_ns))
            else:
                free.discard(match)
                stored[match] = self._correct(tracks[match], seen, position_m, stamp_ns)
        self._tracks = self._alive(stored, stamp_ns)
        confirmed = [t for t in self._tracks if t.num_sightings >= self._config.min_sightings]
        return tuple(self._predict(t, stamp_ns).seen for t in confirmed)

    def clear(self) -> None:
        """Forget all tracks."""
        self._tracks = []

    def _center_map_m(self, seen: DynamicObject, T_map_camera: FloatArray) -> FloatArray:
        center = np.array(seen.center_camera_m, np.float64)
        if seen.class_name == PERSON:
            center *= 1 + self._config.person_depth_m / np.linalg.norm(center)
        return np.asarray(se3.transform(T_map_camera, center[None])[0])

    def _nearest(
        self, tracks: list[_Track], free: set[int], class_name: str, position_m: FloatArray
    ) -> int | None:
        near = [
            (float(np.linalg.norm(tracks[i].seen.position_map_m - position_m)), i)
            for i in sorted(free)
            if tracks[i].seen.class_name == class_name
        ]
        distance_m, i = min(near, default=(np.inf, -1))
        return i if distance_m < self._config.gate_m else None

    def _predict(self, track: _Track, stamp_ns: int) -> _Track:
        if track.seen.state in (ObjectState.AT_REST, ObjectState.MOVED):
            return track
        dt = max(0.0, (stamp_ns - track.seen.stamp_ns) * 1e-9)
        F = np.array([[1, dt], [0, 1]])
        q = self._config.acceleration_sigma_mps2**2
        Q = q * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
        position = track.seen.position_map_m + dt * track.seen.velocity_map_mps
        seen = replace(track.seen, position_map_m=position)
        return replace(track, seen=seen, covariance=F @ track.covariance @ F.T + Q)

    def _correct(
        self, track: _Track, seen: DynamicObject, position_m: FloatArray, stamp_ns: int
    ) -> _Track:
        P = track.covariance
        gain = P[:, 0] / (P[0, 0] + self._config.measurement_sigma_m**2)
        innovation = position_m - track.seen.position_map_m
        position = track.seen.position_map_m + gain[0] * innovation
        velocity = track.seen.velocity_map_mps + gain[1] * innovation
        moving = seen.is_dynamic
        state, still_since_ns = self._state_of(track, seen, position, stamp_ns)
        if not moving:
            velocity = np.zeros(3)
        elif track.seen.state is not ObjectState.HANDLED and seen.class_name != PERSON:
            P = self._fresh_covariance()  # picked up: the resting filter's certainty is void
        now = TrackedObject(
            track.seen.track_id,
            track.seen.class_name,
            state,
            stamp_ns,
            position,
            velocity,
            seen.size_m,
        )
        settled = state in (ObjectState.AT_REST, ObjectState.MOVED)
        return _Track(
            now,
            P - np.outer(gain, P[0]),
            track.rest_place_m if not settled or moving else position,
            still_since_ns,
            track.num_sightings + 1,
        )

    def _state_of(
        self, track: _Track, seen: DynamicObject, position_m: FloatArray, stamp_ns: int
    ) -> tuple[ObjectState, int]:
        """Return the state after a sighting and since when (ns) the object has been still."""
        if seen.class_name == PERSON:
            return ObjectState.PERSON, stamp_ns
        if seen.reason is not Reason.STATIC:
            return ObjectState.HANDLED, stamp_ns
        was = track.seen.state
        if was is not ObjectState.HANDLED:
            return was, track.still_since_ns
        if (stamp_ns - track.still_since_ns) * 1e-9 < self._config.rest_s:
            return was, track.still_since_ns
        carried_m = np.linalg.norm(position_m - track.rest_place_m)
        moved = carried_m > self._config.moved_m
        return ObjectState.MOVED if moved else ObjectState.AT_REST, track.still_since_ns

    def _start(self, seen: DynamicObject, position_m: FloatArray, stamp_ns: int) -> _Track:
        if seen.class_name == PERSON:
            state = ObjectState.PERSON
        else:
            state = ObjectState.HANDLED if seen.is_dynamic else ObjectState.AT_REST
        self._next_id += 1
        now = TrackedObject(
            self._next_id, seen.class_name, state, stamp_ns, position_m, np.zeros(3), seen.size_m
        )
        return _Track(now, self._fresh_covariance(), position_m, stamp_ns, 1)

    def _fresh_covariance(self) -> FloatArray:
        return np.diag([self._config.measurement_sigma_m**2, 1.0])

    def _alive(self, tracks: list[_Track], stamp_ns: int) -> list[_Track]:
        def is_alive(track: _Track) -> bool:
            resting = track.seen.state in (ObjectState.AT_REST, ObjectState.MOVED)
            limit = self._config.forget_resting_s if resting else self._config.forget_moving_s
            if track.num_sightings < self._config.min_sightings:
                limit = self._config.forget_moving_s
            return (stamp_ns - track.seen.stamp_ns) * 1e-9 <= limit

        alive = [t for t in tracks if is_alive(t)]
        alive.sort(key=lambda t: t.seen.stamp_ns)
        return alive[-self._config.max_objects :]
