"""Loop detection: finds a mapped keyframe that shows the same place as a new keyframe.

As in ORB-SLAM3, the place index proposes candidates, RANSAC verifies them, and other keyframes
must confirm the match. Identical furniture may stand in several places. Therefore the correction
must also be a possible drift over the path between the two keyframes, and the surroundings must
not contradict the loop.
"""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.place_config import LoopConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.essential_graph import motion_size, path_length_m
from rgbd_slam.loops.surroundings import CurrentViews, Surroundings
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_tables import NEAR_SHARED
from rgbd_slam.places.geometric_verification import PlaceMatch
from rgbd_slam.places.place_finder import Candidate, FoundPlace, PlaceFinder

_logger = logging.getLogger(__name__)

# Not tuned; with all checks together, no false loop was closed (places_and_loops.md).
_AROUND = 10  # neighbors of the matched keyframe whose points a confirming keyframe must find
_MAX_NEIGHBORS = 5  # neighbors of the new keyframe that may confirm the match
# Largest difference between the pose of a confirming keyframe and the expected one: the matched
# points move by 3.5 % of their distance (2 degrees) in the median, because errors of depth, and of
# the position that follows from it, grow with distance.
_SAME_SHARE = 0.035
# The latest keyframes are no loop candidates (ORB-SLAM3, LoopClosing.cc, NewDetectCommonRegions
# and older DetectLoop). A late mapper may not have connected them with the new keyframe yet, so
# that they would be taken for a loop.
_RECENT = 10
# Chosen: the surroundings are compared if a loop moves a keyframe by more than this distance or
# angle: the loop could lead to another room that looks the same, or to the other side of a
# symmetric one.
_FAR_M = 0.5
_FAR_RAD = 0.5
_CONTRADICTED = 'surroundings: the corrected views contradict the map'
_NOTHING = np.empty(0, np.int64)
_SEEN_FROM_M = 6.0  # chosen: largest distance between a camera and a keyframe that it matches
# Number of verified matches that are kept for confirmation by later keyframes.
_MAX_UNCONFIRMED = 5

# Chosen: if the path of a loop is shorter, its correction is mostly the error of the match.
_MIN_PATH_M = 20.0
_MIN_LOOPS = 3  # chosen: fewer loops do not reveal how much the drift varies
# Chosen: a drift per path length is unusual if it is more than this multiple of the largest one so
# far.
_USUAL_FACTOR = 5.0
# Chosen: a drift of up to 0.5 % of the path is usual for every camera.
_USUAL_SHARE = 0.005
_USUAL_RAD_PER_M = np.deg2rad(0.05)  # chosen: the same for the rotation
# Chosen: keyframes that share fewer points are tied loosely. In blurred images, before a bare wall
# or when a gyro bridges images, keyframes share 8 to 40 points, and the pose was off by up to 0.15
# m and 10 degrees after 1.5 s (office of docs/results/hand_held.md). There, the camera can have
# drifted by more.
_TIED_SHARED = 50
_LOOSE_M, _LOOSE_RAD = 0.15, np.deg2rad(10.0)
# Chosen: places that look alike, such as rooms along a corridor or above each other, are farther
# apart than this. A larger correction is therefore not usual drift, however long the path is.
_APART_M = 2.0


class _Unconfirmed(NamedTuple):
    """A verified match of a keyframe that too few other keyframes have confirmed yet."""

    uid: int  # uid of the keyframe
    map_id: int  # map of the matched keyframe
    T_camera_map: FloatArray  # (4, 4) pose of the keyframe in that map, according to the match


class DriftLimit:
    """Limits of the camera's drift, learned from closed loops."""

    def __init__(self, config: LoopConfig) -> None:
        self._config = config
        # Corrections of the long loops closed so far, divided by path length (without unit,
        # rad/m).
        self._shares: list[float] = []
        self._turns_rad_per_m: list[float] = []

    def is_possible(self, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether a camera can drift by this rotation and distance on such a path."""
        limit = self._config
        max_rad = np.deg2rad(limit.drift_deg + limit.drift_deg_per_m * path_m)
        max_m = limit.drift_m + limit.drift_share * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def is_usual(self, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether a drift is at most five times the largest one of the loops so far.

        Before three long loops, any camera's usual drift is the limit. Over 2 m is never usual.
        """
        factor = _USUAL_FACTOR if len(self._shares) >= _MIN_LOOPS else 0.0
        share = max(_USUAL_SHARE, factor * max(self._shares, default=0.0))
        rad_per_m = max(_USUAL_RAD_PER_M, factor * max(self._turns_rad_per_m, default=0.0))
        max_m = min(self._config.drift_m + share * path_m, _APART_M)
        max_rad = np.deg2rad(self._config.drift_deg) + rad_per_m * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def learn(self, path_m: float, turn_rad: float, distance_m: float) -> None:
        """Learn from the correction of a closed loop, unless its path is shorter than 20 m."""
        if _MIN_PATH_M <= path_m < np.inf:
            self._shares.append(distance_m / path_m)
            self._turns_rad_per_m.append(turn_rad / path_m)


class LoopDetector:
    """Detects loops at new keyframes; it does not change the map."""

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: SlamConfig) -> None:
        self._atlas = atlas
        self._config = config.places.loops
        self._finder = PlaceFinder(atlas, camera, config.places, config.seed)
        self._surroundings = Surroundings(atlas, self._finder.verifier)
        self._drift = DriftLimit(self._config)
        self._unconfirmed: list[_Unconfirmed] = []

    def detect(self, i: int, excluded: IntArray = _NOTHING) -> FoundPlace | None:
        """Return the confirmed match of the keyframe in row `i`; None if there is no loop.

        Keyframes in the rows `excluded` (N,) are no candidates.
        """
        keyframes = self._atlas.keyframes
        seeing = keyframes.point_of_feature[i] != NO_POINT
        excluded = np.r_[self._connected(i), excluded]
        for c in self._finder.candidates(keyframes.descriptors[i, seeing], excluded):
            match, doubt = self._compare(i, c)
            stamp_ns, place_stamp_ns = keyframes.stamp_ns[[i, c]].tolist()
            is_in_other_map = bool(keyframes.map_id[i] != keyframes.map_id[c])
            _logger.debug('%s', Candidate(stamp_ns, place_stamp_ns, is_in_other_map, doubt))
            if match is not None:
                self._unconfirmed = []
                return FoundPlace(c, match)
        return None

    def _compare(self, i: int, c: int) -> tuple[PlaceMatch | None, str]:
        """Return the confirmed match of keyframe `i` with candidate `c`, or None, and a reason."""
        keyframes, path_m = self._atlas.keyframes, path_length_m(self._atlas, c, i)
        match, doubt = self._possible_match(i, c, path_m)
        if match is None:
            return None, doubt
        support = self._num_confirming_matches(i, c, match)
        found = _Unconfirmed(int(keyframes.uid[i]), int(keyframes.map_id[c]), match.T_camera_map)
        self._unconfirmed = [*self._unconfirmed[1 - _MAX_UNCONFIRMED :], found]
        support += self._num_confirming_neighbors(i, c, match)
        if support < self._config.min_support:
            return None, f'support: {support} other keyframes agree'
        found_share, doubt = self._found_share(i, c, match, path_m)
        return (None if doubt else match._replace(found_share=found_share)), doubt

    def index_places(self) -> None:
        """Index all keyframes that are not indexed yet."""
        self._finder.index_places()

    def correction(self, i: int, match: PlaceMatch) -> tuple[float, float]:
        """Return the rotation [rad] and distance [m] by which a loop would move keyframe `i`."""
        return motion_size(match.T_camera_map @ self._atlas.keyframes.T_map_camera[i])

    def _possible_match(self, i: int, c: int, path_m: float) -> tuple[PlaceMatch | None, str]:
        """Return the match with candidate `c` if its drift is possible, or None and the reason."""
        keyframes = self._atlas.keyframes
        apart_m = float(np.linalg.norm(np.subtract(*keyframes.T_map_camera[[i, c], :3, 3])))
        if not self._drift.is_possible(path_m, 0.0, max(apart_m - _SEEN_FROM_M, 0.0)):
            return None, f'drift limit: {apart_m:.2f} m apart after {path_m:.1f} m'
        match = self._finder.verifier.verify(keyframes.frame(i), c)
        if match is None or not self._atlas.guard.is_valid(match.T_camera_map, 'places'):
            return None, self._finder.verifier.doubt or 'geometry: an invalid pose'
        turn_rad, distance_m = self.correction(i, match)
        if not self._is_drift(i, c, path_m, turn_rad, distance_m):
            return (
                None,
                f'drift limit: {distance_m:.2f} m and {turn_rad:.2f} rad in {path_m:.1f} m',
            )
        return match, ''

    def _is_drift(self, i: int, c: int, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether the camera can have drifted by this much between two keyframes.

        The limit is higher if every path between them contains loosely tied keyframes.
        """
        if self._drift.is_possible(path_m, turn_rad, distance_m):
            return True
        rest = max(turn_rad - _LOOSE_RAD, 0.0), max(distance_m - _LOOSE_M, 0.0)
        is_possible = self._drift.is_possible(path_m, *rest)
        return is_possible and not self._atlas.is_connected(c, i, _TIED_SHARED)

    def _connected(self, i: int) -> IntArray:
        """Return the rows (N,) of covisible and recent keyframes, which are no candidates."""
        keyframes = self._atlas.keyframes
        is_recent = keyframes.uid > keyframes.uid[i] - _RECENT
        is_recent &= keyframes.alive & (keyframes.map_id == keyframes.map_id[i])
        direct = self._atlas.covisible(i, NEAR_SHARED)
        around = [self._atlas.covisible(n, NEAR_SHARED) for n in direct.tolist()]
        return np.unique(np.concatenate([[i], direct, *around, np.flatnonzero(is_recent)]))

    def _num_confirming_matches(self, i: int, c: int, match: PlaceMatch) -> int:
        """Return how many stored matches of earlier keyframes are consistent with a new match."""
        keyframes, count = self._atlas.keyframes, 0
        for earlier in self._unconfirmed:
            n = keyframes.index_of(earlier.uid)
            if n is None or n == i or earlier.map_id != keyframes.map_id[c]:
                continue
            if keyframes.map_id[n] == keyframes.map_id[i]:
                expected = self._expected_pose(n, i, match)
                points_m = self._atlas.points.position_m[match.j]
                count += are_same_poses(earlier.T_camera_map, expected, points_m)
        return count

    def _num_confirming_neighbors(self, i: int, c: int, match: PlaceMatch) -> int:
        """Return how many neighbors of keyframe `i` find the points around matched keyframe `c`.

        A neighbor must find them at the pose that follows from the match. Neighbors with a stored
        match are left out, because `_num_confirming_matches` counts them.
        """
        keyframes, count = self._atlas.keyframes, 0
        stored = {earlier.uid for earlier in self._unconfirmed}
        matched = np.r_[c, self._atlas.covisible(c, limit=_AROUND)]
        for n in self._atlas.covisible(i, NEAR_SHARED, _MAX_NEIGHBORS).tolist():
            if int(keyframes.uid[n]) in stored:
                continue
            expected = self._expected_pose(n, i, match)
            found = self._finder.verifier.search(keyframes.frame(n), expected, matched)
            if found is not None:
                points_m = self._atlas.points.position_m[found.j]
                count += are_same_poses(found.T_camera_map, expected, points_m)
        return count

    def _expected_pose(self, n: int, i: int, match: PlaceMatch) -> FloatArray:
        """Return the pose T_camera_map (4, 4) of keyframe `n` according to the match of `i`."""
        poses = self._atlas.keyframes.T_map_camera
        T_n_i: FloatArray = se3.inverse(poses[n]) @ poses[i]
        return T_n_i @ match.T_camera_map

    def _found_share(self, i: int, c: int, match: PlaceMatch, path_m: float) -> tuple[float, str]:
        """Return the found ratio of expected map points, and why the loop is rejected, or ''.

        The drift between different maps is unknown: two maps are merged only if the match has more
        points and the surroundings do not contradict it. Within a map, a correction by 0.5 m or
        0.5 rad and more is checked in three ways. The corrected views must not contradict the map,
        and the current views must not match it. If such a drift is unusual, the current views
        must contradict the map, and the corrected views must agree with it beyond a room unless
        the keyframe moves by less than 2 m. A rejected loop may be accepted at a later keyframe.
        """
        keyframes = self._atlas.keyframes
        if keyframes.map_id[i] != keyframes.map_id[c]:
            if len(match.k) < self._config.merge_inliers:
                return 0.0, f'geometry: {len(match.k)} points are too few to merge maps'
            corrected = self._surroundings.corrected_views(i, c, match)
            return corrected.found_share, _CONTRADICTED if corrected.contradict else ''
        turn_rad, distance_m = self.correction(i, match)
        found_share = match.found_share
        if distance_m >= _FAR_M or turn_rad >= _FAR_RAD:
            corrected = self._surroundings.corrected_views(i, c, match)
            if corrected.contradict:
                return 0.0, _CONTRADICTED
            current = self._surroundings.current_views(i, c)
            if current is CurrentViews.MATCH:
                return 0.0, 'surroundings: the views match the map where they are'
            is_only_place = corrected.agree_beyond_a_room or distance_m < _APART_M
            is_certain = is_only_place and current is CurrentViews.CONTRADICT
            if not (is_certain or self._drift.is_usual(path_m, turn_rad, distance_m)):
                return 0.0, f'drift limit: {distance_m:.2f} m are unusual in {path_m:.1f} m'
            found_share = corrected.found_share
        self._drift.learn(path_m, turn_rad, distance_m)
        return found_share, ''


def are_same_poses(T_camera_map: FloatArray, expected: FloatArray, points_m: FloatArray) -> bool:
    """Return whether most map points (N, 3) have like camera coordinates in two poses (4, 4)."""
    a_m, b_m = (se3.transform(T, points_m) for T in (T_camera_map, expected))
    moved = np.linalg.norm(a_m - b_m, axis=1) / np.linalg.norm(b_m, axis=1)
    return bool(np.median(moved) < _SAME_SHARE)
