"""The surroundings of a recognized place, which distinguish it from a place that looks the same.

Rooms that look alike have different neighbors (decision 047).
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

_AROUND = 10  # not tuned: neighbors of a keyframe whose points are searched in the same view
# Not tuned: radius of the surroundings of a keyframe. The drift over this distance displaces
# points by less than the windows in which they are searched.
_SURROUNDINGS_M = 8.0
_ROOM_M = 8.0  # chosen: the diagonal of a room
# Chosen: largest distance and angle between two keyframes that show mostly the same.
SAME_VIEW_M = 0.7
SAME_VIEW_RAD = 0.4
# Chosen: a view is evaluated if at least this number of points is expected in it. It contradicts
# the place if less than the first share of them is found, as happens by chance at another place,
# and agrees with it if at least the second share is found.
_MIN_EXPECTED = 40
_CONTRADICTING_SHARE = 0.15
_AGREEING_SHARE = 0.5
# Chosen: the surroundings differ if at least this number of views contradicts the place, and at
# least this share of the evaluated views. Fewer may do so at the right place, where furniture was
# moved.
_MIN_CONTRADICTING = 2
_MAX_CONTRADICTING_SHARE = 0.1
# Chosen: a view contradicts the present poses as well if this share of the points in it lies in
# front of the surfaces that it measures, three times as many as a verified place may have.
_IN_FREE_SPACE_SHARE = 0.3
_PRESENT_M = 2.0  # chosen: largest distance of a keyframe whose place is searched in a view


class Comparison(NamedTuple):
    """The result of comparing the keyframes around a new keyframe with those around a place."""

    are_others: bool  # True: the surroundings differ, since too many views contradict the place
    agree_beyond_a_room: bool  # True: two agreeing views are farther apart than a room is long
    found_share: float  # share of the well-known points expected in the views that they show


class Present(Enum):
    """Whether a new keyframe and those around it fit into the map where they are now."""

    FITS = 'fits'  # a view shows the places that are mapped there
    CONTRADICTED = 'contradicted'  # at least two views contradict these places, and none fits
    UNKNOWN = 'unknown'  # nothing that these views could show is mapped there


class Surroundings:
    """Compares what is around a new keyframe with what is around a place.

    Args:
        atlas: The map, which is not changed.
        verifier: Finds points of the map in keyframes.
    """

    def __init__(self, atlas: Atlas, verifier: PlaceVerifier) -> None:
        self._atlas = atlas
        self._verifier = verifier

    def compare(self, i: int, c: int, match: PlaceMatch) -> Comparison:
        """Compare the surroundings of keyframe `i` with those of keyframe `c`.

        The map is not changed. Poses are computed that the keyframes around `i` would have if they
        were moved with it to the place. A keyframe whose view is then nearly that of a keyframe
        around the place should find the points of the place.

        Args:
            i: Row of the new keyframe.
            c: Row of the keyframe that shows the place, in the same map or another one.
            match: The verified pose of keyframe `i` at the place.
        """
        T_map_camera = self._atlas.keyframes.T_map_camera
        T_place_map = match.T_map_camera @ se3.inverse(T_map_camera[i])
        views = list(self._views(*self._sides(i, c), T_place_map, SAME_VIEW_M))
        num_compared, num_contradicting, agreeing = len(views), 0, []
        num_known = num_found = 0.0
        for n, nearest, T_place_n in views:
            seen = self._seen(n, nearest, T_place_n)
            is_expected = seen.num_expected >= _MIN_EXPECTED
            num_compared -= not is_expected
            num_known += seen.num_known
            num_found += seen.num_known_found
            num_contradicting += is_expected and seen.found_share < _CONTRADICTING_SHARE
            least = max(_MIN_CONTRADICTING, _MAX_CONTRADICTING_SHARE * num_compared)
            if num_contradicting >= least:
                return Comparison(True, False, num_found / max(num_known, 1.0))
            if is_expected and seen.found_share >= _AGREEING_SHARE:
                agreeing.append(T_place_n)
        poses = np.reshape(agreeing, (-1, 4, 4))
        longest_m = pose_distances(poses, poses)[0].max(initial=0.0)
        return Comparison(False, bool(longest_m > _ROOM_M), num_found / max(num_known, 1.0))

    def present(self, i: int, c: int) -> Present:
        """Compare the views around keyframe `i` with the map at their present poses.

        A place that looks like another one fits into the map where it is, so that the correction
        to the other one is wrong. A keyframe that has drifted is where other surfaces are mapped,
        as soon as the camera comes near these.

        Args:
            i: Row of the new keyframe.
            c: Row of a keyframe that shows the same place in the same map.
        """
        is_new, num_contradicting = self._is_new(i, c), 0
        place = np.flatnonzero(self._around(i) & ~is_new)
        own = np.flatnonzero(self._visit(i) & is_new)
        for n, nearest, T_map_n in self._views(own, place, np.eye(4), _PRESENT_M):
            if self._fits(n, nearest, T_map_n):
                return Present.FITS
            seen = self._seen(n, nearest, T_map_n)
            is_missing = seen.num_expected >= _MIN_EXPECTED
            is_missing &= seen.found_share < _CONTRADICTING_SHARE
            num_contradicting += is_missing or seen.contradicted_share > _IN_FREE_SPACE_SHARE
        is_contradicted = num_contradicting >= _MIN_CONTRADICTING
        return Present.CONTRADICTED if is_contradicted else Present.UNKNOWN

    def _views(
        self, own: IntArray, place: IntArray, T_new_old: FloatArray, limit_m: float
    ) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield keyframes that would have about the view of one of the place, if they were moved.

        Args:
            own: (N,) rows of the keyframes.
            place: (H,) rows of the keyframes of the place.
            T_new_old: (4, 4) motion of the keyframes in the map frame.
            limit_m: Largest distance to the keyframe of the place.

        Yields:
            The row of a keyframe, that of the nearest one of the place with a similar viewing
            direction, and the moved pose T_map_camera (4, 4).
        """
        T = self._atlas.keyframes.T_map_camera
        moved = T_new_old @ T[own]
        apart_m, apart_rad = pose_distances(moved, T[place])
        apart_m[(apart_m > limit_m) | (apart_rad > SAME_VIEW_RAD)] = np.inf
        for row in np.flatnonzero(np.isfinite(apart_m).any(1)).tolist():
            yield int(own[row]), int(place[np.argmin(apart_m[row])]), moved[row]

    def _seen(self, n: int, nearest: int, T_map_camera: FloatArray) -> PlaceEvidence:
        """Return how well keyframe `n` shows the points around keyframe `nearest` from a pose."""
        around = np.r_[nearest, self._atlas.covisible(nearest, limit=_AROUND)]
        frame = self._atlas.keyframes.frame(n)
        return self._verifier.compare(frame, se3.inverse(T_map_camera), around)

    def _fits(self, n: int, nearest: int, T_map_camera: FloatArray) -> bool:
        """Return whether keyframe `n` shows the place of another one from about a given pose."""
        match = self._verifier.verify(self._atlas.keyframes.frame(n), nearest)
        if match is None:
            return False
        apart_m, apart_rad = pose_distances(match.T_map_camera[None], T_map_camera[None])
        return bool(apart_m[0, 0] < SAME_VIEW_M and apart_rad[0, 0] < SAME_VIEW_RAD)

    def _sides(self, i: int, c: int) -> tuple[IntArray, IntArray]:
        """Return the rows (N,) of the keyframes around `i`, and those (H,) around the place.

        The place is that of keyframe `c`. If `i` and `c` are in one map, no keyframe is on both
        sides, and keyframes around `i` that share points with the place are left out.
        """
        keyframes = self._atlas.keyframes
        own, place = self._visit(i), self._around(c)
        if keyframes.map_id[i] == keyframes.map_id[c]:
            # Of the keyframes of `i`, those that share points with the place are left out: they
            # are at the right pose already.
            is_new = self._is_new(i, c)
            own, place = own & is_new, place & ~is_new
            for row in np.flatnonzero(place).tolist():
                own[self._atlas.covisible(row, NEAR_SHARED)] = False
        return np.flatnonzero(own), np.flatnonzero(place)

    def _is_new(self, i: int, c: int) -> BoolArray:
        """Return the mask of the keyframes that belong to `i`, and not to the place of `c`.

        Those are nearer to `i` than to `c` in order of insertion. The mask is by row.
        """
        uid = self._atlas.keyframes.uid
        return np.asarray(2 * uid > uid[i] + uid[c])

    def _visit(self, i: int) -> BoolArray:
        """Return the mask of the keyframes since the camera came into the surroundings of `i`.

        The mask is by row, as is `i`. The camera has not left these surroundings since then. There
        is no limit of time: the camera may be in a room for long before a place in it is
        recognized, and the views that distinguish this room from others that look alike are those
        in front of its door.
        """
        keyframes = self._atlas.keyframes
        around = self._around(i)
        is_away = keyframes.alive & (keyframes.map_id == keyframes.map_id[i]) & ~around
        is_away &= keyframes.uid < keyframes.uid[i]
        last_away = keyframes.uid[is_away].max(initial=-1)
        return np.asarray(around & (keyframes.uid > last_away))

    def _around(self, i: int) -> BoolArray:
        """Return the mask of the keyframes in the map of `i` within 8 m of it, `i` included.

        The mask is by row, as is `i`.
        """
        keyframes = self._atlas.keyframes
        T = keyframes.T_map_camera
        near = np.linalg.norm(T[:, :3, 3] - T[i, :3, 3], axis=1) < _SURROUNDINGS_M
        return np.asarray(near & keyframes.alive & (keyframes.map_id == keyframes.map_id[i]))


def pose_distances(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (N, M) distances [m] and angles [rad] between the views of two sets of poses.

    Args:
        a: (N, 4, 4) poses T_map_camera; the angle is that between the optical axes (z).
        b: (M, 4, 4) poses T_map_camera in the same frame.
    """
    distance_m = np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=2)
    cosine = a[:, :3, 2] @ b[:, :3, 2].T
    return distance_m, np.arccos(np.clip(cosine, -1, 1))
