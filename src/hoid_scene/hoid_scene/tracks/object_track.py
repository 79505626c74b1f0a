"""The track of one person or object: a constant-velocity Kalman filter with a state of rest.

An object at rest is settled: its velocity is zero, and its measured positions are averaged. The
axes of the filter are independent and have the same noise, so that one (2, 2) covariance serves
all three (Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001,
sec. 6.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common.values import NS_PER_S, PERSON, S_PER_NS, FloatArray, ObjectState
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.tracks.object_sighting import Sighting

# None of these numbers was tuned.
_START_SPEED_MPS = 1.0  # standard deviation of the velocity of a new track, a walking pace
_MIN_IMAGES_WITHOUT = 5  # images that must see through an object's place before it counts as gone
_FADE_S = 0.5  # time constant with which the velocity of an undetected object decays
FRESH_NS = NS_PER_S // 2  # an object that was not detected for longer may have been taken
# Distance over the floor up to which a person can handle an object: an arm and a step. A larger
# value marks more objects near people as handled.
REACH_M = 1.0


@dataclass(frozen=True, eq=False)
class TrackedObject:
    """The published state of a track, in the map frame."""

    track_id: int
    class_name: str
    state: ObjectState
    stamp_ns: int  # stamp of the image that detected it last
    score: float  # score of the last detection, in [0, 1]
    position_map_m: FloatArray  # (3,) center
    velocity_map_mps: FloatArray  # (3,); zero at rest
    size_m: FloatArray  # (3,), extent along the map's axes

    def distance_over_floor_m(self, other: TrackedObject) -> float:
        """Return the horizontal distance [m] to another track."""
        return float(np.linalg.norm((self.position_map_m - other.position_map_m)[:2]))


class KalmanTrack:
    """The Kalman filter of one person or object, and whether it is at rest or handled."""

    def __init__(
        self, track_id: int, sighting: Sighting, stamp_ns: int, config: ObjectTrackerConfig
    ) -> None:
        self.track_id = track_id
        self.class_name = sighting.detection.class_name
        self.state = ObjectState.AT_REST
        if self.class_name == PERSON:
            self.state = ObjectState.PERSON
        elif sighting.detection.state is ObjectState.MOVING:
            self.state = ObjectState.MOVING
        elif sighting.detection.is_dynamic:
            self.state = ObjectState.HANDLED
        self.stamp_ns = stamp_ns
        self.num_sightings = 1
        self._num_images_without = 0
        # True: the object has been taken away to an unknown place, and is not published.
        self.is_taken = False
        self.was_at_rest = self.state is ObjectState.AT_REST
        self._config = config
        self._score, self._size_m = sighting.detection.score, sighting.size_m
        self._position_m = sighting.position_map_m
        self._rest_place_m = sighting.position_map_m
        self._still_place_m, self._still_since_ns = sighting.position_map_m, stamp_ns
        self._restart()

    @property
    def is_confirmed(self) -> bool:
        """Return whether the track is published: detected often enough, and not taken away."""
        return self.num_sightings >= self._config.min_sightings and not self.is_taken

    def position_at_m(self, stamp_ns: int) -> FloatArray:
        """Return the predicted position (3,) [m] in the map frame at a time.

        It is the filtered position if the object is at rest. Any other object moves on with a
        velocity that decays with a time constant of 0.5 s while it is not detected.
        """
        if self.state.is_at_rest:
            return self._position_m
        unseen_s = max(0.0, (stamp_ns - self.stamp_ns) * S_PER_NS)
        ahead_s = _FADE_S * (1 - np.exp(-unseen_s / _FADE_S))
        return np.asarray(self._position_m + ahead_s * self._velocity_mps)

    def value_at(self, stamp_ns: int) -> TrackedObject:
        """Return the published state, with the position that is predicted for a time."""
        return TrackedObject(
            track_id=self.track_id,
            class_name=self.class_name,
            state=self.state,
            stamp_ns=self.stamp_ns,
            score=self._score,
            position_map_m=self.position_at_m(stamp_ns),
            velocity_map_mps=self._velocity_mps,
            size_m=self._size_m,
        )

    def count_seen_through(self) -> None:
        """Count an image that shows that the object is not at its place.

        After five such images without a detection in between, the object counts as taken away.
        """
        self._num_images_without += 1
        self.is_taken = self._num_images_without >= _MIN_IMAGES_WITHOUT

    def is_alive(self, stamp_ns: int) -> bool:
        """Return whether the object was detected recently enough for its track to be kept."""
        config = self._config
        limit_s = config.forget_resting_s if self.state.is_at_rest else config.forget_moving_s
        if self.num_sightings < config.min_sightings:
            limit_s = config.forget_moving_s
        elif self.is_taken:
            limit_s = config.forget_taken_s
        return (stamp_ns - self.stamp_ns) * S_PER_NS <= limit_s

    def correct(self, sighting: Sighting, stamp_ns: int) -> None:
        """Update the filter with a measured position.

        A settled object becomes HANDLED if the detection is dynamic and more than `moved_m` away.
        A handled object that stays within `moved_m` of a place for `rest_s` becomes settled.
        """
        self.num_sightings += 1
        self._num_images_without = 0
        self._score, self._size_m = sighting.detection.score, sighting.size_m
        if self.state.is_at_rest and self._is_away(sighting):
            self.state = ObjectState.HANDLED
            self._still_since_ns = stamp_ns
            self._restart()
        self._filter(sighting.position_map_m, (stamp_ns - self.stamp_ns) * S_PER_NS)
        self.stamp_ns = stamp_ns
        if self.state is ObjectState.HANDLED:
            self._settle_if_still(stamp_ns)

    def confirm(self, sighting: Sighting, stamp_ns: int) -> None:
        """Record that the object is still at rest at its place, without updating position or size.

        Use it while a person hides part of the object: the center of the visible part is not the
        center of the object.
        """
        self.num_sightings += 1
        self._num_images_without = 0
        self._score, self.stamp_ns = sighting.detection.score, stamp_ns

    def put_down(self, sighting: Sighting, stamp_ns: int) -> None:
        """Restart the filter at the position where an object that was taken away is seen again."""
        self.is_taken = False
        self.state = ObjectState.HANDLED
        self._position_m = self._still_place_m = sighting.position_map_m
        self._still_since_ns = self.stamp_ns = stamp_ns
        self._restart()
        self.correct(sighting, stamp_ns)

    def _is_away(self, sighting: Sighting) -> bool:
        offset_m = np.linalg.norm(sighting.position_map_m - self._position_m)
        return bool(sighting.detection.is_dynamic and offset_m > self._config.moved_m)

    def _restart(self) -> None:
        self._velocity_mps = np.zeros(3)
        self._P = np.diag([self._config.measurement_sigma_m**2, _START_SPEED_MPS**2])

    def _filter(self, position_m: FloatArray, dt: float) -> None:
        predicted = self._position_m + dt * self._velocity_mps
        if not self.state.is_at_rest:
            F = np.array([[1, dt], [0, 1]])
            q = self._config.acceleration_sigma_mps2**2
            Q = q * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
            self._P = F @ self._P @ F.T + Q
        gain = self._P[:, 0] / (self._P[0, 0] + self._config.measurement_sigma_m**2)
        innovation = position_m - predicted
        self._position_m = predicted + gain[0] * innovation
        if not self.state.is_at_rest:
            self._velocity_mps = self._velocity_mps + gain[1] * innovation
        self._P = self._P - np.outer(gain, self._P[0])

    def _settle_if_still(self, stamp_ns: int) -> None:
        if np.linalg.norm(self._position_m - self._still_place_m) > self._config.moved_m:
            self._still_place_m, self._still_since_ns = self._position_m, stamp_ns
        if (stamp_ns - self._still_since_ns) * S_PER_NS < self._config.rest_s:
            return
        carried_m = np.linalg.norm(self._position_m - self._rest_place_m)
        was_moved = carried_m > self._config.moved_m
        self.state = ObjectState.MOVED if was_moved else ObjectState.AT_REST
        self._rest_place_m = self._position_m
        self.was_at_rest = True
        self._restart()
