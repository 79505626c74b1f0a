"""How a map fits to other maps: by several places, because a single one may look like another."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.loops.loop_closer import LoopCloser
from rgbd_slam.loops.loop_detection import motion_size
from rgbd_slam.loops.surroundings import SAME_VIEW_M, SAME_VIEW_RAD, pose_distances
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.places.place_finder import FoundPlace

# Chosen: keyframes that show a place of the other map after which no more are searched.
_ENOUGH = 8
# Chosen: two places are the same fit if they place a keyframe within this distance and angle of
# each other; the maps may have drifted between them.
_SAME_FIT_M, _SAME_FIT_RAD = 1.0, 0.3
_MAX_ELSEWHERE = 0.25  # chosen: share of the keyframes whose places contradict the fit
# building.md: two drives in one corridor find 0.85 of the expected points of each other, and two
# floors with 13 and 33 % of their own 0.72 and 0.55.
_MIN_FOUND_SHARE = 0.8


class MapFit(NamedTuple):
    """How a map fits to another one: the places by which most of its keyframes agree."""

    i: int  # row of the keyframe that shows the place with most points
    place: FoundPlace
    num_places: int  # views, more than 0.7 m or 0.4 rad apart, that show places of the fit
    is_one_place: bool  # whether one of the maps has no views that are so far apart
    num_elsewhere: int  # keyframes that show places by which the map would lie elsewhere
    found_share: float  # mean share of the expected points that were found

    @property
    def doubt(self) -> str:
        """Return why the maps need not show the same places; '' without a doubt."""
        if self.num_elsewhere > _MAX_ELSEWHERE * (self.num_elsewhere + self.num_places):
            return f'{self.num_elsewhere} of its keyframes fit elsewhere'
        if self.num_places == 1 and not self.is_one_place:
            return 'only one place fits'
        if self.found_share < _MIN_FOUND_SHARE:
            return f'only {100 * self.found_share:.0f} % of the expected points were found'
        return ''


class _Hit(NamedTuple):
    i: int
    place: FoundPlace
    T_other_map: FloatArray  # (4, 4) from the frame of the map to that of the other one


def map_fits(atlas: Atlas, closer: LoopCloser, rows: IntArray, excluded: IntArray) -> list[MapFit]:
    """Return how the map of keyframes fits to each other map that it shows places of.

    Nothing is changed.

    Args:
        atlas: The maps.
        closer: Finds the places.
        rows: (K,) keyframes of the map.
        excluded: (N,) keyframes whose places are not searched, those of the map included.
    """
    keyframes = atlas.keyframes
    hits: defaultdict[int, list[_Hit]] = defaultdict(list)
    for i in _spread(rows):
        place = closer.find(i, excluded)
        if place is None:
            continue
        T = place.match.T_map_camera @ se3.inverse(keyframes.T_map_camera[i])
        others = hits[int(keyframes.map_id[place.keyframe])]
        others.append(_Hit(i, place, T))
        if len(others) == _ENOUGH:
            break
    return [_fit(atlas, found) for found in hits.values()]


def _fit(atlas: Atlas, hits: Sequence[_Hit]) -> MapFit:
    """Return the fit of the largest number of hits that agree with one of them."""
    agreeing = max(([b for b in hits if _agree(a, b)] for a in hits), key=len)
    best = max(agreeing, key=lambda hit: len(hit.place.match.k))
    keyframes = atlas.keyframes
    maps = (
        np.flatnonzero(keyframes.map_id == keyframes.map_id[i]) for i in (best.i, best.place[0])
    )
    return MapFit(
        best.i,
        best.place,
        _num_apart(keyframes.T_map_camera[[hit.i for hit in agreeing]]),
        any(_is_one_place(keyframes.T_map_camera[rows]) for rows in maps),
        len(hits) - len(agreeing),
        float(np.mean([hit.place.found_share for hit in agreeing])),
    )


def _agree(a: _Hit, b: _Hit) -> bool:
    """Return whether two places put the keyframe of the second one at about the same pose."""
    T_camera_other = b.place.match.T_camera_map
    T_map_camera = se3.inverse(b.T_other_map) @ b.place.match.T_map_camera
    turn_rad, distance_m = motion_size(T_camera_other @ a.T_other_map @ T_map_camera)
    return turn_rad < _SAME_FIT_RAD and distance_m < _SAME_FIT_M


def _num_apart(poses: FloatArray) -> int:
    """Return the number of poses (N, 4, 4) with views that are different from one another."""
    is_same = _are_same_views(poses, poses)
    chosen: list[int] = []
    for n in range(len(poses)):
        if not is_same[n, chosen].any():
            chosen.append(n)
    return len(chosen)


def _is_one_place(poses: FloatArray) -> bool:
    """Return whether all poses (N, 4, 4) have about the view of the first one."""
    return bool(_are_same_views(poses[:1], poses).all())


def _are_same_views(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return the (N, M) mask of poses (N, 4, 4) and (M, 4, 4) with about the same view."""
    apart_m, apart_rad = pose_distances(a, b)
    return np.asarray((apart_m < SAME_VIEW_M) & (apart_rad < SAME_VIEW_RAD))


def _spread(rows: IntArray) -> Iterator[int]:
    """Yield all rows once: first a few that are spread evenly, then those between them."""
    step = 1 << max(len(rows) - 1, 0).bit_length()
    seen: set[int] = set()
    while step >= 1:
        for i in rows[::step].tolist():
            if i not in seen:
                seen.add(i)
                yield i
        step //= 2
