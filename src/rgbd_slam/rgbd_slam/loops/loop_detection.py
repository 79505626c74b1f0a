"""Loops: seeing that a keyframe shows a place known from before.

Appearance proposes a place, geometry verifies it, keyframes around and keyframes just before must
agree, and the correction must be within the drift that the way there explains: a chair like
another is no loop.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.essential_graph import path_length_m
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.geometric_verification import PlaceMatch, PlaceStatus
from rgbd_slam.places.place_finder import NEAR_SHARED, FoundPlace, PlaceFinder

_AROUND = 10  # keyframes around the place whose points supporters are searched for
_SUPPORTERS = 5  # keyframes asked for support
_SUPPORT_M = 0.05  # by how much a supporter's own pose may differ from the expected one
_SUPPORT_RAD = 0.035
_REMEMBERED = 5  # sightings that later keyframes may confirm


class _Sighting(NamedTuple):
    """A place that a keyframe was verified to show."""

    uid: int  # of the keyframe
    map_id: int  # of the place
    T_camera_place: FloatArray  # (4, 4) from the place's map


class LoopDetector:
    """Watches the keyframes of a map that it does not change."""

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: SlamConfig) -> None:
        self._atlas = atlas
        self._config = config.places.loops
        self._finder = PlaceFinder(atlas, camera, config.places, config.seed)
        self._sightings: list[_Sighting] = []

    def detect(self, i: int) -> FoundPlace | None:
        """Return a place far from keyframe `i`, or in another map, that it shows without doubt."""
        keyframes = self._atlas.keyframes
        seeing = keyframes.point_of_feature[i] != NO_POINT
        for c in self._finder.candidates(keyframes.descriptors[i, seeing], self._near(i)):
            match = self._finder.verifier.verify(keyframes.frame(i), c)
            if match.status is not PlaceStatus.SAME_PLACE:
                continue
            support = self._support_in_time(i, c, match)
            self._remember(i, c, match)
            support += self._support_around(i, c, match)
            if support >= self._config.min_support and self._is_plausible(i, c, match):
                self._sightings = []
                return FoundPlace(c, match)
        return None

    def correction(self, i: int, match: PlaceMatch) -> tuple[float, float]:
        """Return the angle [rad] and the way [m] from where `i` is to where it belongs."""
        return motion_size(match.T_camera_map @ self._atlas.keyframes.T_map_camera[i])

    def _near(self, i: int) -> IntArray:
        """Return the keyframe, its neighbours, and theirs: no loop leads there."""
        direct = self._atlas.covisible(i, NEAR_SHARED)
        around = [self._atlas.covisible(n, NEAR_SHARED) for n in direct.tolist()]
        return np.unique(np.concatenate([[i], direct, *around]))

    def _remember(self, i: int, c: int, match: PlaceMatch) -> None:
        keyframes = self._atlas.keyframes
        sighting = _Sighting(int(keyframes.uid[i]), int(keyframes.map_id[c]), match.T_camera_map)
        self._sightings = [*self._sightings[1 - _REMEMBERED :], sighting]

    def _support_in_time(self, i: int, c: int, match: PlaceMatch) -> int:
        """Return how many earlier keyframes saw the same place from where `i` implies."""
        keyframes = self._atlas.keyframes
        support = 0
        for sighting in self._sightings:
            n = keyframes.index_of(sighting.uid)
            if n is None or keyframes.map_id[n] != keyframes.map_id[i]:
                continue
            agrees = _agree(sighting.T_camera_place, self._expected(n, i, match))
            support += n != i and sighting.map_id == keyframes.map_id[c] and agrees
        return support

    def _support_around(self, i: int, c: int, match: PlaceMatch) -> int:
        """Return how many keyframes around `i` see the place, too, where `i` says they should."""
        keyframes = self._atlas.keyframes
        known = {sighting.uid for sighting in self._sightings}  # counted before
        place = np.r_[c, self._atlas.covisible(c, limit=_AROUND)]
        support = 0
        for n in self._atlas.covisible(i, NEAR_SHARED, _SUPPORTERS).tolist():
            if int(keyframes.uid[n]) in known:
                continue
            expected = self._expected(n, i, match)
            seen = self._finder.verifier.search(keyframes.frame(n), expected, place)
            agrees = _agree(seen.T_camera_map, expected)
            support += seen.status is PlaceStatus.SAME_PLACE and agrees
        return support

    def _expected(self, n: int, i: int, match: PlaceMatch) -> FloatArray:
        """Return (4, 4) T_camera_place of keyframe `n` if that of `i` is the match's."""
        poses = self._atlas.keyframes.T_map_camera
        T_n_i: FloatArray = se3.inverse(poses[n]) @ poses[i]
        return T_n_i @ match.T_camera_map

    def _is_plausible(self, i: int, c: int, match: PlaceMatch) -> bool:
        """Return whether drift on the way from `c` to `i` explains the correction.

        Between maps nothing is known of the drift; then more points have to be found.
        """
        limit, map_id = self._config, self._atlas.keyframes.map_id
        if map_id[i] != map_id[c]:
            return len(match.k) >= limit.merge_inliers
        turn_rad, way_m = self.correction(i, match)
        path_m = path_length_m(self._atlas, c, i)
        most_rad = np.deg2rad(limit.drift_deg + limit.drift_deg_per_m * path_m)
        return bool(way_m <= limit.drift_m + limit.drift_share * path_m and turn_rad <= most_rad)


def motion_size(T: FloatArray) -> tuple[float, float]:
    """Return the angle [rad] and the length [m] of a motion (4, 4)."""
    return float(np.linalg.norm(se3.log(T)[:3])), float(np.linalg.norm(T[:3, 3]))


def _agree(T: FloatArray, expected: FloatArray) -> bool:
    turn_rad, way_m = motion_size(T @ se3.inverse(expected))
    return turn_rad < _SUPPORT_RAD and way_m < _SUPPORT_M
