"""Loop detection: whether a keyframe shows a known place.

The place index proposes keyframes, and geometry verifies them. Identical furniture may stand in
several places. Therefore other keyframes must confirm the place, and the correction must not
exceed the drift that the length of the path between the two keyframes explains. Finally, the
surroundings must not contradict the place: rooms that look alike have different neighbors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.drift_limit import APART_M, DriftLimit
from rgbd_slam.loops.essential_graph import path_length_m
from rgbd_slam.loops.surroundings import Present, Surroundings
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_tables import NEAR_SHARED
from rgbd_slam.places.geometric_verification import PlaceMatch
from rgbd_slam.places.place_finder import FoundPlace, PlaceFinder

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
# Chosen: a loop that moves a keyframe by more than this distance or angle could lead to another
# room that looks the same, or to the other side of a symmetric one, so that the surroundings are
# compared.
_FAR_M = 0.5
_FAR_RAD = 0.5
_NOTHING = np.empty(0, np.int64)
_SEEN_FROM_M = 6.0  # chosen: the farthest that a camera may be from a keyframe and see its place
_MAX_DETECTIONS = 5  # latest verified places that later keyframes may confirm


class _Detection(NamedTuple):
    """A place that was verified for a keyframe, but not confirmed by others yet."""

    uid: int  # of the keyframe
    map_id: int  # the map that the place belongs to
    T_camera_place: FloatArray  # (4, 4) T_camera_map of the keyframe in that map, by the place


class LoopDetector:
    """Detects loops at new keyframes of a map, which it does not change."""

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: SlamConfig) -> None:
        self._atlas = atlas
        self._config = config.places.loops
        self._finder = PlaceFinder(atlas, camera, config.places, config.seed)
        self._surroundings = Surroundings(atlas, self._finder.verifier)
        self._drift = DriftLimit(self._config)
        self._detections: list[_Detection] = []

    def detect(self, i: int, excluded: IntArray = _NOTHING) -> FoundPlace | None:
        """Return the confirmed place that the keyframe in row `i` shows again, or None.

        The place is outside the neighborhood of the keyframe, or in another map. Places that are
        verified but not confirmed are remembered, so that later keyframes may confirm them; they
        are all forgotten once a place is confirmed. The drift of a confirmed loop within a map is
        remembered as well.

        Args:
            i: Row of the keyframe.
            excluded: (N,) rows of other keyframes whose places are not searched.
        """
        keyframes = self._atlas.keyframes
        seeing = keyframes.point_of_feature[i] != NO_POINT
        excluded = np.r_[self._neighborhood(i), excluded]
        for c in self._finder.candidates(keyframes.descriptors[i, seeing], excluded):
            path_m = path_length_m(self._atlas, c, i)
            match = self._explained_match(i, c, path_m)
            if match is None:
                continue
            support = self._support_in_time(i, c, match)
            self._remember(i, c, match)
            support += self._support_around(i, c, match)
            if support < self._config.min_support:
                continue
            found_share = self._found_share(i, c, match, path_m)
            if found_share is not None:
                self._detections = []
                return FoundPlace(c, match, found_share)
        return None

    def index_places(self) -> None:
        """Index all keyframes that are not indexed yet."""
        self._finder.index_places()

    def correction(self, i: int, match: PlaceMatch) -> tuple[float, float]:
        """Return the rotation [rad] and distance [m] by which a loop would move a keyframe.

        `i` is the row of the keyframe, and `match` its pose at a place of the same map.
        """
        return motion_size(match.T_camera_map @ self._atlas.keyframes.T_map_camera[i])

    def _explained_match(self, i: int, c: int, path_m: float) -> PlaceMatch | None:
        """Return the pose of keyframe `i` at the place of `c`; None if no drift explains it.

        Where a pattern repeats, many places look the same. Most of them are so far away that they
        need not be verified.

        Args:
            i: Row of the keyframe.
            c: Row of the keyframe that shows the place.
            path_m: Length of the path between the two; infinite between different maps.
        """
        keyframes = self._atlas.keyframes
        apart_m = float(np.linalg.norm(np.subtract(*keyframes.T_map_camera[[i, c], :3, 3])))
        if not self._drift.explains(path_m, 0.0, max(apart_m - _SEEN_FROM_M, 0.0)):
            return None
        match = self._finder.verifier.verify(keyframes.frame(i), c)
        if match is None or not self._atlas.guard.is_valid(match.T_camera_map, 'places'):
            return None
        is_explained = self._drift.explains(path_m, *self.correction(i, match))
        return match if is_explained else None

    def _neighborhood(self, i: int) -> IntArray:
        """Return the rows of the keyframes that are no loop candidates for the one in row `i`.

        These are the keyframe, its neighbors, the neighbors of its neighbors, and recent
        keyframes of its map.
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
        """Return how many remembered detections of earlier keyframes support the match of `i`.

        A detection supports it if its keyframe is in the map of `i`, its place is in the map of
        `c`, and its pose there is the one that follows from the match.

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
        """Return how many neighbors of keyframe `i` show the place of keyframe `c` as expected.

        `i` and `c` are rows; a neighbor must see the place from the pose that follows from the
        match. Neighbors with a remembered detection are left out, since `_support_in_time`
        evaluates these.
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
        """Return T_camera_map (4, 4) that keyframe `n` has at the place if the match is right.

        Args:
            n: Row of another keyframe in the map of `i`.
            i: Row of the keyframe.
            match: The verified pose of keyframe `i` at the place.
        """
        poses = self._atlas.keyframes.T_map_camera
        T_n_i: FloatArray = se3.inverse(poses[n]) @ poses[i]
        return T_n_i @ match.T_camera_map

    def _found_share(self, i: int, c: int, match: PlaceMatch, path_m: float) -> float | None:
        """Return the share of the expected points that were found; None if `i` is elsewhere.

        None is returned if the surroundings exclude that `i` shows the place of `c`.
        The share is that of the surroundings if these were compared, else that of the view. `i`
        and `c` are rows. The drift between different maps is unknown: two maps are merged only
        if more points are found, and if their surroundings do not differ. Within a map, the
        surroundings are compared before a keyframe is moved by 0.5 m or turned by 0.5 rad or more,
        and the keyframes must not fit into the map where they are now. If such a drift is unusual
        (`DriftLimit.is_usual`), the map must also contradict the present poses, and agreeing views
        must be farther apart than a room is long, unless the correction is smaller than 2 m. Until
        then, the loop waits. The drift of an accepted loop within a map is added to the drift
        limit.
        """
        keyframes = self._atlas.keyframes
        if keyframes.map_id[i] != keyframes.map_id[c]:
            if len(match.k) < self._config.merge_inliers:
                return None
            seen = self._surroundings.compare(i, c, match)
            return None if seen.are_others else seen.found_share
        turn_rad, distance_m = self.correction(i, match)
        found_share = match.found_share
        if distance_m >= _FAR_M or turn_rad >= _FAR_RAD:
            seen = self._surroundings.compare(i, c, match)
            present = Present.FITS if seen.are_others else self._surroundings.present(i, c)
            if present is Present.FITS:
                return None
            is_alone = seen.agree_beyond_a_room or distance_m < APART_M
            is_known = is_alone and present is Present.CONTRADICTED
            if not (is_known or self._drift.is_usual(path_m, turn_rad, distance_m)):
                return None
            found_share = seen.found_share
        self._drift.add(path_m, turn_rad, distance_m)
        return found_share


def motion_size(T: FloatArray) -> tuple[float, float]:
    """Return the rotation angle [rad] and the translation [m] of a motion (4, 4)."""
    return float(np.linalg.norm(se3.log(T)[:3])), float(np.linalg.norm(T[:3, 3]))


def _are_consistent(T: FloatArray, expected: FloatArray) -> bool:
    turn_rad, distance_m = motion_size(T @ se3.inverse(expected))
    return turn_rad < _SUPPORT_RAD and distance_m < _SUPPORT_M
