"""Loop detection: whether a keyframe shows a known place.

The place index proposes places, which geometry verifies. In addition, other keyframes must confirm
the place, and the correction must not exceed the drift that the path between both explains,
because identical furniture stands in several places. Finally, what is around must not contradict
the place: rooms that look alike have different neighbors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.essential_graph import path_length_m
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.geometric_verification import PlaceMatch
from rgbd_slam.places.place_finder import NEAR_SHARED, FoundPlace, PlaceFinder

# Not tuned; places_and_loops.md: no false loop with all checks together.
_AROUND = 10  # neighbors of the place whose points are searched in the confirming keyframes
_MAX_SUPPORTERS = 5  # neighbors of the keyframe that may confirm the place
# Largest difference of a confirming keyframe's pose from the expected one: 5 cm and 2 degrees.
_SUPPORT_M = 0.05
_SUPPORT_RAD = 0.035
# ORB-SLAM3, LoopClosing.cc, NewDetectCommonRegions and older DetectLoop: the latest keyframes are
# no loop candidates. A late mapper may not have connected them with the new keyframe yet, so that
# they would be recognized as a loop.
_RECENT = 10
# The surroundings of a place are compared if the keyframe would move farther than this, or between
# maps. Smaller motions do not lead to another room.
_FAR_M = 0.5
_SURROUNDINGS_M = 8.0  # not tuned: the drift up to this distance is within the search windows
# Views of two keyframes that show mostly the same.
_SAME_VIEW_M = 0.7
_SAME_VIEW_RAD = 0.4
# A view contradicts a place if so many points are expected in it and at most this share is found.
# At the same place it is more than the half; at another one, points are found by chance.
_MIN_EXPECTED = 40
_CONTRADICTING_SHARE = 0.15
# So many views, and this share of all, must contradict: in a known place, furniture is moved too.
_MIN_CONTRADICTING = 2
_MAX_CONTRADICTING_SHARE = 0.1
_MAX_DETECTIONS = 5  # latest verified places that later keyframes may confirm


class _Detection(NamedTuple):
    """A verified place of a keyframe."""

    uid: int  # the keyframe
    map_id: int  # the map of the place
    T_camera_place: FloatArray  # (4, 4) pose of the keyframe in that map


class LoopDetector:
    """Detects loops at new keyframes of a map, which it does not change."""

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: SlamConfig) -> None:
        self._atlas = atlas
        self._config = config.places.loops
        self._finder = PlaceFinder(atlas, camera, config.places, config.seed)
        self._detections: list[_Detection] = []

    def detect(self, i: int) -> FoundPlace | None:
        """Return the confirmed place that keyframe `i` shows again, or None if there is none.

        The place is outside the neighborhood of the keyframe, or in another map. Places that are
        verified but not confirmed are remembered, so that later keyframes may confirm them.
        """
        keyframes = self._atlas.keyframes
        seeing = keyframes.point_of_feature[i] != NO_POINT
        for c in self._finder.candidates(keyframes.descriptors[i, seeing], self._neighborhood(i)):
            match = self._finder.verifier.verify(keyframes.frame(i), c)
            if match is None:
                continue
            support = self._support_in_time(i, c, match)
            self._remember(i, c, match)
            support += self._support_around(i, c, match)
            is_place = support >= self._config.min_support and self._is_plausible(i, c, match)
            if is_place and not self._is_contradicted(i, c, match):
                self._detections = []
                return FoundPlace(c, match)
        return None

    def index_places(self) -> None:
        """Index all keyframes that are not indexed yet."""
        self._finder.index_places()

    def correction(self, i: int, match: PlaceMatch) -> tuple[float, float]:
        """Return the rotation [rad] and distance [m] by which a loop would move keyframe `i`."""
        return motion_size(match.T_camera_map @ self._atlas.keyframes.T_map_camera[i])

    def _neighborhood(self, i: int) -> IntArray:
        """Return the keyframes that are no loop candidates for keyframe `i`.

        These are the keyframe, its neighbors, the neighbors of its neighbors, and recent
        keyframes.
        """
        keyframes = self._atlas.keyframes
        is_recent = keyframes.uid > keyframes.uid[i] - _RECENT
        is_recent &= keyframes.alive & (keyframes.map_id == keyframes.map_id[i])
        direct = self._atlas.covisible(i, NEAR_SHARED)
        around = [self._atlas.covisible(n, NEAR_SHARED) for n in direct.tolist()]
        return np.unique(np.concatenate([[i], direct, *around, np.flatnonzero(is_recent)]))

    def _remember(self, i: int, c: int, match: PlaceMatch) -> None:
        keyframes = self._atlas.keyframes
        detection = _Detection(int(keyframes.uid[i]), int(keyframes.map_id[c]), match.T_camera_map)
        self._detections = [*self._detections[1 - _MAX_DETECTIONS :], detection]

    def _support_in_time(self, i: int, c: int, match: PlaceMatch) -> int:
        """Return how many earlier keyframes showed the map of `c` at a pose consistent with `i`.

        Args:
            i: Row of the keyframe.
            c: Row of the keyframe that shows the place.
            match: The verified pose of keyframe `i` at the place.
        """
        keyframes = self._atlas.keyframes
        support = 0
        for detection in self._detections:
            n = keyframes.index_of(detection.uid)
            if n is None or keyframes.map_id[n] != keyframes.map_id[i]:
                continue
            is_consistent = _are_consistent(detection.T_camera_place, self._expected(n, i, match))
            support += n != i and detection.map_id == keyframes.map_id[c] and is_consistent
        return support

    def _support_around(self, i: int, c: int, match: PlaceMatch) -> int:
        """Return how many neighbors of `i` show the place of `c` at the expected pose.

        Neighbors that `_support_in_time` counts are left out.
        """
        keyframes = self._atlas.keyframes
        counted = {detection.uid for detection in self._detections}
        place = np.r_[c, self._atlas.covisible(c, limit=_AROUND)]
        support = 0
        for n in self._atlas.covisible(i, NEAR_SHARED, _MAX_SUPPORTERS).tolist():
            if int(keyframes.uid[n]) in counted:
                continue
            expected = self._expected(n, i, match)
            seen = self._finder.verifier.search(keyframes.frame(n), expected, place)
            support += seen is not None and _are_consistent(seen.T_camera_map, expected)
        return support

    def _expected(self, n: int, i: int, match: PlaceMatch) -> FloatArray:
        """Return T_camera_place (4, 4) of keyframe `n` if the match of keyframe `i` is right."""
        poses = self._atlas.keyframes.T_map_camera
        T_n_i: FloatArray = se3.inverse(poses[n]) @ poses[i]
        return T_n_i @ match.T_camera_map

    def _is_plausible(self, i: int, c: int, match: PlaceMatch) -> bool:
        """Return whether the drift on the path from `c` to `i` can explain the correction.

        The drift between different maps is unknown: two maps are merged only if more points are
        found.
        """
        limit, map_id = self._config, self._atlas.keyframes.map_id
        if map_id[i] != map_id[c]:
            return len(match.k) >= limit.merge_inliers
        turn_rad, distance_m = self.correction(i, match)
        path_m = path_length_m(self._atlas, c, i)
        max_rad = np.deg2rad(limit.drift_deg + limit.drift_deg_per_m * path_m)
        max_m = limit.drift_m + limit.drift_share * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def _is_contradicted(self, i: int, c: int, match: PlaceMatch) -> bool:
        """Return whether the surroundings of keyframe `i` differ from those of the place.

        Other keyframes around `i` are moved with it. Those that then have the view of a keyframe
        around the place should find its points.
        """
        keyframes = self._atlas.keyframes
        is_same_map = keyframes.map_id[i] == keyframes.map_id[c]
        if is_same_map and self.correction(i, match)[1] < _FAR_M:
            return False
        own, place = self._visit(i), self._around(c)
        if is_same_map:
            # The place is the part of the map that is nearer in time to `c`. Keyframes that share
            # points with it are already where they belong.
            is_new = 2 * keyframes.uid > keyframes.uid[i] + keyframes.uid[c]
            own, place = own & is_new, place & ~is_new
            for row in np.flatnonzero(place).tolist():
                own[self._atlas.covisible(row, NEAR_SHARED)] = False
        n, h = np.flatnonzero(own), np.flatnonzero(place)
        T_place_map = match.T_map_camera @ se3.inverse(keyframes.T_map_camera[i])
        T_place_n = T_place_map @ keyframes.T_map_camera[n]
        apart = pose_distances(T_place_n, keyframes.T_map_camera[h])
        has_same_view = (apart[0] < _SAME_VIEW_M) & (apart[1] < _SAME_VIEW_RAD)
        compared = np.flatnonzero(has_same_view.any(1))
        num_compared, num_contradicting = len(compared), 0
        for row in compared.tolist():
            nearest = int(h[np.argmin(np.where(has_same_view[row], apart[0][row], np.inf))])
            seen = self._finder.verifier.compare(
                keyframes.frame(int(n[row])),
                se3.inverse(T_place_n[row]),
                np.r_[nearest, self._atlas.covisible(nearest, limit=_AROUND)],
            )
            is_expected = seen.num_expected >= _MIN_EXPECTED
            num_compared -= not is_expected
            num_contradicting += is_expected and seen.found_share < _CONTRADICTING_SHARE
            if num_contradicting >= max(
                _MIN_CONTRADICTING, _MAX_CONTRADICTING_SHARE * num_compared
            ):
                return True
        return False

    def _visit(self, i: int) -> BoolArray:
        """Return the mask of the keyframes since the camera came to the surroundings of `i`.

        The camera has not left the surroundings in between: a room may be seen for any time before
        a place in it is recognized, and what tells it from others is in front of its door.
        """
        keyframes = self._atlas.keyframes
        around = self._around(i)
        is_away = keyframes.alive & (keyframes.map_id == keyframes.map_id[i]) & ~around
        is_away &= keyframes.uid < keyframes.uid[i]
        last_away = keyframes.uid[is_away].max(initial=-1)
        return np.asarray(around & (keyframes.uid > last_away))

    def _around(self, i: int) -> BoolArray:
        """Return the mask of the keyframes of the same map within the surroundings of `i`."""
        keyframes = self._atlas.keyframes
        T = keyframes.T_map_camera
        near = np.linalg.norm(T[:, :3, 3] - T[i, :3, 3], axis=1) < _SURROUNDINGS_M
        return np.asarray(near & keyframes.alive & (keyframes.map_id == keyframes.map_id[i]))


def pose_distances(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances [m] and the angles [rad] of view (N, M) of poses (N or M, 4, 4)."""
    distance_m = np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=2)
    cosine = a[:, :3, 2] @ b[:, :3, 2].T
    return distance_m, np.arccos(np.clip(cosine, -1, 1))


def motion_size(T: FloatArray) -> tuple[float, float]:
    """Return the rotation angle [rad] and the translation [m] of a motion (4, 4)."""
    return float(np.linalg.norm(se3.log(T)[:3])), float(np.linalg.norm(T[:3, 3]))


def _are_consistent(T: FloatArray, expected: FloatArray) -> bool:
    turn_rad, distance_m = motion_size(T @ se3.inverse(expected))
    return turn_rad < _SUPPORT_RAD and distance_m < _SUPPORT_M
