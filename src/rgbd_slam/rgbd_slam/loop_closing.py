"""Loops: seeing that a keyframe shows a known place, and drawing the map together there.

Appearance proposes a place, geometry verifies it, keyframes around must agree, and the correction
must be within the drift that the way there explains: a chair like another is no loop.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config import SlamConfig
from rgbd_slam.essential_graph import Loop, closed_poses, move_map, path_length_m
from rgbd_slam.frame import StereoCamera
from rgbd_slam.fusing import fuse
from rgbd_slam.geometric_verification import PlaceMatch, PlaceStatus
from rgbd_slam.global_adjustment import GlobalAdjuster
from rgbd_slam.keyframes import NO_POINT
from rgbd_slam.map import SlamMap
from rgbd_slam.map_merging import merge_maps
from rgbd_slam.place_finder import NEAR_SHARED, PlaceFinder

_AROUND = 10  # keyframes on either side whose points are fused
_SUPPORTERS = 5  # keyframes asked for support
_SUPPORT_M = 0.05  # by how much a supporter's own pose may differ from the expected one
_SUPPORT_RAD = 0.035


class LoopEvent(Enum):
    """What a keyframe brought about."""

    NOTHING = 'nothing'
    REJOINED = 'rejoined'  # a place seen before, reached with hardly any drift
    CLOSED = 'closed'
    MERGED = 'merged'  # two maps into one


class LoopCloser:
    """Watches the keyframes of a map that it may change."""

    def __init__(
        self,
        slam_map: SlamMap,
        camera: StereoCamera,
        config: SlamConfig,
        *,
        background: bool = False,
    ) -> None:
        self._map = slam_map
        self._camera = camera
        self._config = config.places.loops
        self._mapping = config.mapping
        self._finder = PlaceFinder(slam_map, camera, config.places, config.seed)
        self._loops: list[Loop] = []
        self._adjuster = GlobalAdjuster(
            slam_map, camera, self._config.global_iterations, background=background
        )

    def process(self, i: int) -> LoopEvent:
        """Look whether a settled keyframe shows a place known from before, and act on it."""
        self.poll()
        if not self._config.enabled:
            return LoopEvent.NOTHING
        keyframes = self._map.keyframes
        seeing = keyframes.point_of_feature[i] != NO_POINT
        for c in self._finder.candidates(keyframes.descriptors[i, seeing], self._near(i)):
            match = self._finder.verifier.verify(keyframes.frame(i), c)
            if match.status is not PlaceStatus.SAME_PLACE or not self._is_supported(i, c, match):
                continue
            if keyframes.map_id[i] == keyframes.map_id[c]:
                if self._is_plausible(i, c, match):
                    return self._close(i, c, match)
            elif len(match.k) >= self._config.merge_inliers:
                return self._merge(i, c, match)
        return LoopEvent.NOTHING

    def poll(self) -> bool:
        """Take in a global adjustment that has ended; return whether there was one."""
        return self._adjuster.poll()

    def close(self) -> None:
        """End what runs in the background."""
        self._adjuster.close()

    def _near(self, i: int) -> IntArray:
        """Return the keyframe, its neighbours, and theirs: no loop leads there."""
        direct = self._map.covisible(i, NEAR_SHARED)
        around = [self._map.covisible(n, NEAR_SHARED) for n in direct.tolist()]
        return np.unique(np.concatenate([[i], direct, *around]))

    def _is_supported(self, i: int, c: int, match: PlaceMatch) -> bool:
        """Return whether keyframes around `i` see the place, too, where `i` says they should."""
        keyframes = self._map.keyframes
        place = np.r_[c, self._map.covisible(c, limit=_AROUND)]
        support = 0
        for n in self._map.covisible(i, NEAR_SHARED, _SUPPORTERS).tolist():
            T_n_i = se3.inverse(keyframes.T_map_camera[n]) @ keyframes.T_map_camera[i]
            expected = T_n_i @ match.T_camera_map
            seen = self._finder.verifier.search(keyframes.frame(n), expected, place)
            turn_rad, way_m = _size(seen.T_camera_map @ se3.inverse(expected))
            agrees = turn_rad < _SUPPORT_RAD and way_m < _SUPPORT_M
            support += seen.status is PlaceStatus.SAME_PLACE and agrees
        return support >= self._config.min_support

    def _is_plausible(self, i: int, c: int, match: PlaceMatch) -> bool:
        """Return whether drift on the way from `c` to `i` explains the correction."""
        turn_rad, way_m = _size(self._correction(i, match))
        path_m = path_length_m(self._map, c, i)
        limit = self._config
        most_deg = limit.drift_deg + limit.drift_deg_per_m * path_m
        return way_m <= limit.drift_m + limit.drift_share * path_m and turn_rad <= np.deg2rad(
            most_deg
        )

    def _correction(self, i: int, match: PlaceMatch) -> FloatArray:
        """Return (4, 4) from where `i` belongs to where it is, in its own frame."""
        T_map_camera: FloatArray = self._map.keyframes.T_map_camera[i]
        return match.T_camera_map @ T_map_camera

    def _close(self, i: int, c: int, match: PlaceMatch) -> LoopEvent:
        keyframes = self._map.keyframes
        turn_rad, way_m = _size(self._correction(i, match))
        small = way_m < self._config.small_m and turn_rad < np.deg2rad(self._config.small_deg)
        T_c_i = se3.inverse(keyframes.T_map_camera[c]) @ match.pose
        self._loops.append(Loop(int(keyframes.uid[c]), int(keyframes.uid[i]), T_c_i))
        map_id = int(keyframes.map_id[i])
        shared = self._config.essential_shared
        move_map(self._map, *closed_poses(self._map, map_id, self._loops, shared))
        self._fuse(i, c)
        if small:
            return LoopEvent.REJOINED
        self._adjuster.start(map_id)
        return LoopEvent.CLOSED

    def _merge(self, i: int, c: int, match: PlaceMatch) -> LoopEvent:
        keyframes = self._map.keyframes
        T_c_i = se3.inverse(keyframes.T_map_camera[c]) @ match.pose
        merge_maps(self._map, i, c, T_c_i)
        self._fuse(i, c)
        self._adjuster.start(int(keyframes.map_id[i]))
        return LoopEvent.MERGED

    def _fuse(self, i: int, c: int) -> None:
        """Let keyframes on each side observe the points of the other, fusing doubles."""
        here = np.r_[i, self._map.covisible(i, limit=_AROUND)]
        there = np.setdiff1d(np.r_[c, self._map.covisible(c, limit=_AROUND)], here)
        for side, other in ((here, there), (there, here)):
            for n in side.tolist():
                seen = np.unique(self._map.keyframes.point_of_feature[other])
                points = seen[seen != NO_POINT].astype(np.int64)
                fuse(self._map, self._camera, n, points, self._mapping)
        for n in np.r_[here, there].tolist():
            self._map.update_connections(n)
        seen = np.unique(self._map.keyframes.point_of_feature[np.r_[here, there]])
        self._map.refresh(seen[seen != NO_POINT].astype(np.int64))


def _size(T: FloatArray) -> tuple[float, float]:
    """Return the angle [rad] and the length [m] of a motion."""
    twist = se3.log(T)
    return float(np.linalg.norm(twist[:3])), float(np.linalg.norm(T[:3, 3]))
