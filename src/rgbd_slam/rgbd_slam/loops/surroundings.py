"""Checks a loop hypothesis with the views of the keyframes around the new keyframe.

Rooms that look alike have different surroundings (decision 047). If the hypothesis is right, the
keyframes around see the mapped points when they are moved with the new keyframe. If it is wrong,
they see the points that are mapped at their current poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_tables import NEAR_SHARED
from rgbd_slam.places.geometric_verification import PlaceEvidence, PlaceMatch, PlaceVerifier

_AROUND = 10  # not tuned: neighbors of a keyframe whose points are searched in a view
# Not tuned: radius of the surroundings of a keyframe. Over this distance, drift displaces points
# by less than the search windows.
_SURROUNDINGS_M = 8.0
_ROOM_M = 8.0  # chosen: the diagonal of a room
# Chosen: largest distance and angle between two keyframes with about the same view.
SAME_VIEW_M = 0.7
SAME_VIEW_RAD = 0.4
# Chosen: a view is evaluated if at least this number of points is expected in it. It contradicts
# the map if less than the first ratio of them is found, as happens by chance at another place, and
# agrees with the map if at least the second ratio is found.
_MIN_EXPECTED = 40
_CONTRADICTING_SHARE = 0.15
_AGREEING_SHARE = 0.5
# Chosen: the corrected views contradict the map if at least this number of them, and at least this
# ratio of the evaluated ones, does. Fewer may do so at the right place if furniture was moved.
_MIN_CONTRADICTING = 2
_MAX_CONTRADICTING_SHARE = 0.1
# Chosen: a current view also contradicts the map if at least this ratio of its expected points
# lies in front of the surfaces that it measures, three times as many as at a verified place.
_IN_FREE_SPACE_SHARE = 0.3
# Chosen: largest distance between a current view and a keyframe that is matched with it.
_CURRENT_M = 2.0


class CorrectedViews(NamedTuple):
    """Evaluation of the surrounding keyframes' views at poses corrected by the loop hypothesis."""

    contradict: bool  # True: too many views do not show the map points that are expected in them
    # True: two views that agree with the map are farther apart than a room is long.
    agree_beyond_a_room: bool
    found_share: float  # ratio of the well-observed points expected in all views that were found


class CurrentViews(Enum):
    """Evaluation of the surrounding keyframes' views at their current poses in the map."""

    MATCH = 'match'  # a view shows the points mapped at its current pose: the loop is wrong
    CONTRADICT = 'contradict'  # at least two views contradict the map, and none matches it
    UNKNOWN = 'unknown'  # too little is mapped where these views could show it


class Surroundings:
    """Compares the views of keyframes around a new keyframe with the map, without changing it."""

    def __init__(self, atlas: Atlas, verifier: PlaceVerifier) -> None:
        self._atlas = atlas
        self._verifier = verifier

    def corrected_views(self, i: int, c: int, match: PlaceMatch) -> CorrectedViews:
        """Evaluate the views around keyframe `i` at the poses that a match with `c` implies."""
        T_map_camera = self._atlas.keyframes.T_map_camera
        T_corrected_map = match.T_map_camera @ se3.inverse(T_map_camera[i])
        views = list(self._overlapping(*self._visits(i, c), T_corrected_map, SAME_VIEW_M))
        num_evaluated, num_contradicting, agreeing = len(views), 0, []
        num_known = num_found = 0.0
        is_contradicted = False
        for n, nearest, T_map_n in views:
            evidence = self._evidence(n, nearest, T_map_n)
            num_known += evidence.num_known
            num_found += evidence.num_known_found
            num_evaluated -= evidence.num_expected < _MIN_EXPECTED
            num_contradicting += _contradicts(evidence)
            least = max(_MIN_CONTRADICTING, _MAX_CONTRADICTING_SHARE * num_evaluated)
            if is_contradicted := num_contradicting >= least:
                break
            if _is_evaluated(evidence) and evidence.found_share >= _AGREEING_SHARE:
                agreeing.append(T_map_n)
        poses = np.reshape(agreeing, (-1, 4, 4))
        longest_m = pose_distances(poses, poses)[0].max(initial=0.0)
        share = num_found / max(num_known, 1.0)
        return CorrectedViews(is_contradicted, bool(longest_m > _ROOM_M), share)

    def current_views(self, i: int, c: int) -> CurrentViews:
        """Evaluate the views around keyframe `i` at their current poses.

        If the room only looks like that of the matched keyframe `c`, the views match the points
        that are mapped at these poses.
        """
        is_later, num_contradicting = self._is_later(i, c), 0
        mapped = np.flatnonzero(self._is_near(i) & ~is_later)
        visit = np.flatnonzero(self._is_in_visit(i) & is_later)
        for n, nearest, T_map_n in self._overlapping(visit, mapped, np.eye(4), _CURRENT_M):
            if self._has_pose(n, nearest, T_map_n):
                return CurrentViews.MATCH
            evidence = self._evidence(n, nearest, T_map_n)
            is_in_free_space = evidence.contradicted_share > _IN_FREE_SPACE_SHARE
            num_contradicting += _contradicts(evidence) or is_in_free_space
        is_contradicted = num_contradicting >= _MIN_CONTRADICTING
        return CurrentViews.CONTRADICT if is_contradicted else CurrentViews.UNKNOWN

    def _overlapping(
        self, visit: IntArray, mapped: IntArray, T_new_old: FloatArray, limit_m: float
    ) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield the keyframes that have the view of a mapped keyframe after a motion.

        The keyframes in rows `visit` (N,) are moved by T_new_old (4, 4) in the map frame. Yield
        the row of such a keyframe, the row of the nearest keyframe of `mapped` (H,) with a similar
        viewing direction, and the new pose T_map_camera (4, 4).
        """
        T = self._atlas.keyframes.T_map_camera
        moved = T_new_old @ T[visit]
        apart_m, apart_rad = pose_distances(moved, T[mapped])
        apart_m[(apart_m > limit_m) | (apart_rad > SAME_VIEW_RAD)] = np.inf
        for n in np.flatnonzero(np.isfinite(apart_m).any(1)).tolist():
            yield int(visit[n]), int(mapped[np.argmin(apart_m[n])]), moved[n]

    def _evidence(self, n: int, nearest: int, T_map_camera: FloatArray) -> PlaceEvidence:
        """Compare keyframe `n` at a pose (4, 4) with the points around the keyframe `nearest`."""
        around = np.r_[nearest, self._atlas.covisible(nearest, limit=_AROUND)]
        frame = self._atlas.keyframes.frame(n)
        return self._verifier.compare(frame, se3.inverse(T_map_camera), around)

    def _has_pose(self, n: int, nearest: int, T_map_camera: FloatArray) -> bool:
        """Return whether keyframe `n` matches `nearest` at about the given pose (4, 4)."""
        match = self._verifier.verify(self._atlas.keyframes.frame(n), nearest)
        return match is not None and bool(
            are_same_views(match.T_map_camera[None], T_map_camera[None])[0, 0]
        )

    def _visits(self, i: int, c: int) -> tuple[IntArray, IntArray]:
        """Return rows (N,) of recent keyframes around `i`, and (H,) of mapped ones around `c`."""
        keyframes = self._atlas.keyframes
        visit, mapped = self._is_in_visit(i), self._is_near(c)
        if keyframes.map_id[i] == keyframes.map_id[c]:
            is_later = self._is_later(i, c)
            visit, mapped = visit & is_later, mapped & ~is_later
            for row in np.flatnonzero(mapped).tolist():
                visit[self._atlas.covisible(row, NEAR_SHARED)] = False
        return np.flatnonzero(visit), np.flatnonzero(mapped)

    def _is_later(self, i: int, c: int) -> BoolArray:
        """Return by row whether a keyframe was inserted nearer to `i` than to `c` in order."""
        uid = self._atlas.keyframes.uid
        return np.asarray(2 * uid > uid[i] + uid[c])

    def _is_in_visit(self, i: int) -> BoolArray:
        """Return by row whether a keyframe was inserted after the camera came near `i` last.

        There is no limit of time: the camera may stay in a room for long before a place in it is
        recognized, and the views that distinguish it from similar rooms are those before its door.
        """
        keyframes = self._atlas.keyframes
        is_near = self._is_near(i)
        is_away = keyframes.alive & (keyframes.map_id == keyframes.map_id[i]) & ~is_near
        is_away &= keyframes.uid < keyframes.uid[i]
        last_away = keyframes.uid[is_away].max(initial=-1)
        return np.asarray(is_near & (keyframes.uid > last_away))

    def _is_near(self, i: int) -> BoolArray:
        """Return by row whether a keyframe is in the map of `i` and within 8 m of it."""
        keyframes = self._atlas.keyframes
        T = keyframes.T_map_camera
        near = np.linalg.norm(T[:, :3, 3] - T[i, :3, 3], axis=1) < _SURROUNDINGS_M
        return np.asarray(near & keyframes.alive & (keyframes.map_id == keyframes.map_id[i]))


def _is_evaluated(evidence: PlaceEvidence) -> bool:
    return evidence.num_expected >= _MIN_EXPECTED


def _contradicts(evidence: PlaceEvidence) -> bool:
    return _is_evaluated(evidence) and evidence.found_share < _CONTRADICTING_SHARE


def are_same_views(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return (N, M) whether poses (N, 4, 4) and (M, 4, 4) have about the same view."""
    apart_m, apart_rad = pose_distances(a, b)
    return np.asarray((apart_m < SAME_VIEW_M) & (apart_rad < SAME_VIEW_RAD))


def pose_distances(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distances (N, M) in m of poses T_map_camera, and angles (rad) of optical axes."""
    distance_m = np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=2)
    cosine = a[:, :3, 2] @ b[:, :3, 2].T
    return distance_m, np.arccos(np.clip(cosine, -1, 1))
