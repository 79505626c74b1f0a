"""Loops: drawing the map together where a place was seen again, and merging maps."""

from __future__ import annotations

import logging
from enum import Enum
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.local_mapping.fusing import fuse
from rgbd_slam.loops.essential_graph import Loop, closed_poses, move_map, path_length_m
from rgbd_slam.loops.global_adjustment import GlobalAdjuster
from rgbd_slam.loops.loop_detection import LoopDetector
from rgbd_slam.loops.map_merging import merge_maps
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.geometric_verification import PlaceMatch

_AROUND = 10  # keyframes on either side whose points are fused
_NO_MAP = -1

_logger = logging.getLogger(__name__)


class LoopEvent(Enum):
    """What a keyframe brought about."""

    NOTHING = 'nothing'
    REJOINED = 'rejoined'  # a place seen before, by a short way and with hardly any drift
    CLOSED = 'closed'
    MERGED = 'merged'  # two maps into one


class Join(NamedTuple):
    """What was found to be seen from where; logged, so that it can be held against the truth."""

    event: LoopEvent
    stamp_ns: int  # of the image
    place_stamp_ns: int  # of the image taken at the place before
    T_place_camera: FloatArray  # (4, 4)

    def __str__(self) -> str:
        ago_s = S_PER_NS * (self.stamp_ns - self.place_stamp_ns)
        return f'{self.event.value}: a place seen {ago_s:.1f} s before'


class LoopCounts(NamedTuple):
    """How often the map was drawn together."""

    closed: int = 0
    merged: int = 0

    def with_event(self, event: LoopEvent) -> LoopCounts:
        """Return the counts after an event."""
        closed = self.closed + (event is LoopEvent.CLOSED)
        return LoopCounts(closed, self.merged + (event is LoopEvent.MERGED))


class LoopCloser:
    """Watches the keyframes of a map, and corrects the map.

    Args:
        atlas: The map.
        camera: Its camera.
        config: Parameters.
        background: Adjust whole maps in a process of their own.
    """

    def __init__(
        self,
        atlas: Atlas,
        camera: StereoCamera,
        config: SlamConfig,
        *,
        background: bool = False,
    ) -> None:
        self._atlas = atlas
        self._camera = camera
        self._config = config.places.loops
        self._mapping = config.mapping
        self._detector = LoopDetector(atlas, camera, config)
        self._loops: list[Loop] = []
        self._looped = _NO_MAP  # the last map to be adjusted as a whole
        self._has_more = False  # keyframes since then
        self._adjuster = GlobalAdjuster(
            atlas, camera, self._config.global_iterations, background=background
        )

    def process(self, i: int) -> LoopEvent:
        """Look whether a settled keyframe shows a place known from before, and act on it."""
        self.poll()
        self._has_more |= int(self._atlas.keyframes.map_id[i]) == self._looped
        found = self._detector.detect(i) if self._config.enabled else None
        if found is None:
            return LoopEvent.NOTHING
        c, match = found
        T_c_i = se3.inverse(self._atlas.keyframes.T_map_camera[c]) @ match.pose
        if self._atlas.keyframes.map_id[i] == self._atlas.keyframes.map_id[c]:
            event = self._close(i, c, match, T_c_i)
        else:
            event = self._merge(i, c, T_c_i)
        stamp_ns = self._atlas.keyframes.stamp_ns
        _logger.info('%s', Join(event, int(stamp_ns[i]), int(stamp_ns[c]), T_c_i))
        return event

    def poll(self) -> bool:
        """Take in a global adjustment that has ended; return whether there was one."""
        return self._adjuster.poll()

    @property
    def is_adjusting(self) -> bool:
        """Return whether a whole map is being adjusted in the background."""
        return self._adjuster.is_running

    def settle(self, limit_s: float) -> None:
        """Adjust a map with loops once more, whole, if it has grown since; wait up to a limit."""
        self._adjuster.poll(limit_s)
        if self._has_more and not self._adjuster.is_running:
            self._adjust(self._looped)
            self._adjuster.poll(limit_s)

    def close(self) -> None:
        """End what runs in the background."""
        self._adjuster.close()

    def _close(self, i: int, c: int, match: PlaceMatch, T_c_i: FloatArray) -> LoopEvent:
        keyframes, config = self._atlas.keyframes, self._config
        turn_rad, way_m = self._detector.correction(i, match)
        around_m = path_length_m(self._atlas, c, i)
        small = way_m < config.small_m and turn_rad < np.deg2rad(config.small_deg)
        small &= around_m < config.long_path_m
        alive = set(keyframes.uid[keyframes.alive].tolist())
        self._loops = [loop for loop in self._loops if {loop.uid_a, loop.uid_b} <= alive]
        self._loops.append(Loop(int(keyframes.uid[c]), int(keyframes.uid[i]), T_c_i))
        map_id = int(keyframes.map_id[i])
        move_map(
            self._atlas, *closed_poses(self._atlas, map_id, self._loops, config.essential_shared)
        )
        self._fuse(i, c)
        # A solution of the map as it was would undo what has just been drawn together.
        is_outdated = self._adjuster.is_running and self._looped == map_id
        if not small or is_outdated:
            self._adjust(map_id)
        return LoopEvent.REJOINED if small else LoopEvent.CLOSED

    def _merge(self, i: int, c: int, T_c_i: FloatArray) -> LoopEvent:
        merge_maps(self._atlas, i, c, T_c_i)
        self._fuse(i, c)
        self._adjust(int(self._atlas.keyframes.map_id[i]))
        return LoopEvent.MERGED

    def _adjust(self, map_id: int) -> None:
        self._adjuster.start(map_id)
        self._looped, self._has_more = map_id, False

    def _fuse(self, i: int, c: int) -> None:
        """Let keyframes on each side observe the points of the other, fusing doubles."""
        here = np.r_[i, self._atlas.covisible(i, limit=_AROUND)]
        there = np.setdiff1d(np.r_[c, self._atlas.covisible(c, limit=_AROUND)], here)
        for side, other in ((here, there), (there, here)):
            for n in side.tolist():
                seen = np.unique(self._atlas.keyframes.point_of_feature[other])
                points = seen[seen != NO_POINT].astype(np.int64)
                fuse(self._atlas, self._camera, n, points, self._mapping)
        for n in np.r_[here, there].tolist():
            self._atlas.update_connections(n)
        seen = np.unique(self._atlas.keyframes.point_of_feature[np.r_[here, there]])
        self._atlas.refresh(seen[seen != NO_POINT].astype(np.int64))
