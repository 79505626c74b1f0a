"""Matching of a map with other maps by several keyframes, because places may look alike."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.loops.essential_graph import motion_size
from rgbd_slam.loops.loop_detection import LoopDetector
from rgbd_slam.loops.surroundings import are_same_views
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.places.place_finder import FoundPlace

_ENOUGH = 8  # chosen: no more matches with another map are searched after this number
# Chosen: two matches are consistent if the poses that follow from them differ by less than this
# distance and angle; the maps may have drifted between them.
_SAME_M, _SAME_RAD = 1.0, 0.3
_MAX_ELSEWHERE = 0.25  # chosen: largest ratio of matches that are inconsistent with the others
# Least mean ratio of expected points that are found (building.md): two drives in one corridor find
# 0.85 of each other's points; two floors with 13 and 33 % of distinct furniture 0.72 and 0.55.
_MIN_FOUND_SHARE = 0.8


class MapFit(NamedTuple):
    """The largest set of consistent matches between a map's keyframes and another map."""

    i: int  # row of the keyframe whose match has the most points
    place: FoundPlace  # match of this keyframe
    num_places: int  # number of different views (`are_same_views`) among the consistent matches
    is_one_place: bool  # whether one of the two maps has only one view
    num_elsewhere: int  # number of matches that would put the map elsewhere
    found_share: float  # mean ratio of the expected points that were found

    @property
    def doubt(self) -> str:
        """Return why the two maps may not show the same places; '' if they do."""
        if self.num_elsewhere > _MAX_ELSEWHERE * (self.num_elsewhere + self.num_places):
            return f'{self.num_elsewhere} of its keyframes fit elsewhere'
        if self.num_places == 1 and not self.is_one_place:
            return 'only one place fits'
        if self.found_share < _MIN_FOUND_SHARE:
            return f'only {100 * self.found_share:.0f} % of the expected points were found'
        return ''


class _Match(NamedTuple):
    i: int  # row of the keyframe
    T_map_camera: FloatArray  # (4, 4) its pose in its own map
    place: FoundPlace

    @property
    def T_other_map(self) -> FloatArray:  # noqa: N802
        """Return the transform (4, 4) between the two maps according to the match."""
        return self.place.match.T_map_camera @ se3.inverse(self.T_map_camera)


def map_fits(
    atlas: Atlas, detector: LoopDetector, rows: IntArray, excluded: IntArray
) -> list[MapFit]:
    """Return the fit of a map with each other map that its keyframes match.

    Args:
        rows: (K,) keyframes of the map.
        excluded: (N,) keyframes that are not candidates, including those of the map.
    """
    keyframes = atlas.keyframes
    matches: defaultdict[int, list[_Match]] = defaultdict(list)
    # All keyframes are tried: first a few that are spread evenly, then those between them.
    steps = [1 << n for n in range(len(rows).bit_length(), -1, -1)]
    for i in dict.fromkeys(i for step in steps for i in rows[::step].tolist()):
        place = detector.detect(i, excluded)
        if place is None:
            continue
        others = matches[int(keyframes.map_id[place.keyframe])]
        others.append(_Match(i, keyframes.T_map_camera[i], place))
        if len(others) == _ENOUGH:
            break
    return [_fit(atlas, found) for found in matches.values()]


def _fit(atlas: Atlas, matches: Sequence[_Match]) -> MapFit:
    consistent = max(([b for b in matches if _agree(a, b)] for a in matches), key=len)
    best = max(consistent, key=lambda found: len(found.place.match.k))
    keyframes = atlas.keyframes
    maps = (
        keyframes.T_map_camera[keyframes.map_id == keyframes.map_id[i]]
        for i in (best.i, best.place.keyframe)
    )
    return MapFit(
        best.i,
        best.place,
        _num_views(np.array([found.T_map_camera for found in consistent])),
        any(bool(are_same_views(poses[:1], poses).all()) for poses in maps),
        len(matches) - len(consistent),
        float(np.mean([found.place.match.found_share for found in consistent])),
    )


def _agree(a: _Match, b: _Match) -> bool:
    """Return whether both matches put the keyframe of the second one at about the same pose."""
    T = b.place.match.T_camera_map @ a.T_other_map @ b.T_map_camera
    turn_rad, distance_m = motion_size(T)
    return turn_rad < _SAME_RAD and distance_m < _SAME_M


def _num_views(poses: FloatArray) -> int:
    """Return the number of different views among poses (N, 4, 4)."""
    is_same = are_same_views(poses, poses)
    chosen: list[int] = []
    for n in range(len(poses)):
        if not is_same[n, chosen].any():
            chosen.append(n)
    return len(chosen)
