"""Loop closing and map merging: corrects the map when a known place is seen again."""

from __future__ import annotations

import logging
from enum import Enum
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.local_mapping.fusion import fuse
from rgbd_slam.loops.essential_graph import (
    loop_covariance,
    move_map,
    optimized,
    path_length_m,
    region_around,
)
from rgbd_slam.loops.global_adjustment import GlobalAdjuster
from rgbd_slam.loops.loop_detection import LoopDetector
from rgbd_slam.loops.loop_removal import remove_loop
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.loop_edge import JOIN, LoopEdge
from rgbd_slam.model.map_change import Move
from rgbd_slam.places.place_finder import FoundPlace

_AROUND = 10  # not tuned: points of this many neighbors of both keyframes of a loop are fused
_NO_MAP = -1
# Chosen: largest number of keyframes that are moved around a loop with hardly any drift.
# Recordings of rooms have fewer; in a building, the limit makes the time of such a loop
# independent of the size of the map.
_SMALL_LOOP = 200

_logger = logging.getLogger(__name__)


class LoopEvent(Enum):
    """The result of processing a keyframe."""

    NOTHING = 'nothing'
    # Short loop with hardly any drift, after which no global adjustment follows.
    REJOINED = 'rejoined'
    CLOSED = 'closed'
    MERGED = JOIN  # two maps have become one


class Join(NamedTuple):
    """A closed loop or a merge between a new keyframe and an earlier one at the same place."""

    edge: LoopEdge  # loop edge from the earlier keyframe to the new one
    place_stamp_ns: int  # stamp of the earlier keyframe
    stamp_ns: int  # stamp of the new keyframe
    # Distance (m) and rotation (rad) by which the new keyframe was moved; None for two maps, whose
    # relative pose was unknown.
    correction: tuple[float, float] | None

    @property
    def event(self) -> LoopEvent:
        """Return the kind of event: a closed loop or merged maps."""
        return LoopEvent(self.edge.kind)

    def __str__(self) -> str:
        ago_s = S_PER_NS * (self.stamp_ns - self.place_stamp_ns)
        return f'{self.edge.kind}: a place seen {ago_s:.1f} s before'


class LoopCounts(NamedTuple):
    """Numbers of closed loops, without `LoopEvent.REJOINED`, and of merged maps."""

    closed: int = 0
    merged: int = 0

    def with_event(self, event: LoopEvent) -> LoopCounts:
        closed = self.closed + (event is LoopEvent.CLOSED)
        return LoopCounts(closed, self.merged + (event is LoopEvent.MERGED))


class LoopCloser:
    """Detects loops at new keyframes and corrects the map."""

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
        self.detector = LoopDetector(atlas, camera, config)
        self._adjusted_map = _NO_MAP  # id of the map that was adjusted last
        self._has_grown = False  # whether that map got keyframes since then
        self.last_join: Join | None = None  # the join at the last keyframe; None: there was none
        self.adjuster = GlobalAdjuster(
            atlas, camera, self._config.global_iterations, background=background
        )

    def process(self, i: int) -> LoopEvent:
        """Close a loop at the new keyframe in row `i`, or merge its map with another one.

        A finished global adjustment is applied first, even if loop closing is off.
        """
        self.adjuster.poll()
        self._has_grown |= int(self._atlas.keyframes.map_id[i]) == self._adjusted_map
        self.last_join = None
        found = self.detector.detect(i) if self._config.enabled else None
        return LoopEvent.NOTHING if found is None else self.close_at(i, found)

    def close_at(self, i: int, place: FoundPlace) -> LoopEvent:
        """Correct the map by a match that `detector` has found, and store it in `last_join`."""
        keyframes, c = self._atlas.keyframes, place.keyframe
        place_stamp_ns, stamp_ns = keyframes.stamp_ns[[c, i]].tolist()
        correction: tuple[float, float] | None = None
        if keyframes.map_id[i] == keyframes.map_id[c]:
            turn_rad, distance_m = self.detector.correction(i, place.match)
            correction = distance_m, turn_rad
            event = self._close(i, place, *correction)
        else:
            event = self._merge(i, place)
        if event is not LoopEvent.NOTHING:
            self.last_join = Join(self._atlas.loops[-1], place_stamp_ns, stamp_ns, correction)
            _logger.info('%s', self.last_join)
        return event

    def remove(self, number: int) -> None:
        """Remove a loop or merge, by its number in the map, and adjust the map again."""
        keyframes, uids = self._atlas.keyframes, self._atlas.loops[number][:2]
        remove_loop(self._atlas, self._camera, number, self._config.essential_shared)
        for edge in self._atlas.loops:
            if ends := keyframes.ends_of(edge):
                self._fuse(ends[1], ends[0])
        rows = keyframes.rows_of(np.array(uids))
        if (rows >= 0).any():
            self._adjust(rows[rows >= 0])

    def index_places(self) -> None:
        """Index all keyframes now; this takes seconds for a loaded map with thousands of them."""
        if self._config.enabled:
            self.detector.index_places()

    def settle(self, limit_s: float) -> None:
        """Repeat the last global adjustment if keyframes have been added to its map since then.

        Wait up to `limit_s` for a running adjustment, and as long for the repeated one.
        """
        self.adjuster.poll(limit_s)
        if self._has_grown and not self.adjuster.is_running:
            keyframes = self._atlas.keyframes
            rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == self._adjusted_map))
            self._adjust(rows[[np.argmax(keyframes.uid[rows])]])
            self.adjuster.poll(limit_s)

    def _close(self, i: int, place: FoundPlace, distance_m: float, turn_rad: float) -> LoopEvent:
        """Optimize the pose graph with a new loop, and fuse the points around both keyframes.

        A global adjustment follows, unless the loop is short and hardly moves the new keyframe.
        """
        keyframes, config, c = self._atlas.keyframes, self._config, place.keyframe
        path_m = path_length_m(self._atlas, c, i)
        is_small = distance_m < config.small_m and turn_rad < np.deg2rad(config.small_deg)
        is_small &= path_m < config.long_path_m
        event = LoopEvent.REJOINED if is_small else LoopEvent.CLOSED
        self._add_edge(i, place, event)
        ends = np.array([c, i])
        region = region_around(self._atlas, ends, _SMALL_LOOP if is_small else len(keyframes))
        T_map_camera, loops = optimized(self._atlas, region, config.essential_shared)
        if not loops[-1].is_used:
            self._atlas.loops = (*self._atlas.loops[:-1], loops[-1])
            return LoopEvent.NOTHING
        self._atlas.loops = loops
        self.adjuster.rebase(move_map(self._atlas, region.rows, T_map_camera))
        self._fuse(i, c)
        if not is_small:
            self._adjust(ends)
        return event

    def _merge(self, i: int, place: FoundPlace) -> LoopEvent:
        c, edge = place.keyframe, self._add_edge(i, place, LoopEvent.MERGED)
        self.adjuster.rebase(merge_maps(self._atlas, i, c, edge.T_first_second))
        self._fuse(i, c)
        self._adjust(np.array([c, i]))
        return LoopEvent.MERGED

    def _add_edge(self, i: int, place: FoundPlace, event: LoopEvent) -> LoopEdge:
        """Add a loop edge for a match to the map, whose poses are not changed here."""
        (c, match), keyframes = place, self._atlas.keyframes
        uid_c, uid_i = keyframes.uid[[c, i]].tolist()
        edge = LoopEdge(
            uid_c,
            uid_i,
            se3.inverse(keyframes.T_map_camera[c]) @ match.T_map_camera,
            loop_covariance(match),
            len(match.k),
            match.found_share,
            event.value,
            residual_m=0.0,
            is_used=True,
        )
        self._atlas.loops += (edge,)
        return edge

    def _adjust(self, around: IntArray) -> None:
        self.adjuster.start(around)
        self._adjusted_map = int(self._atlas.keyframes.map_id[around[0]])
        self._has_grown = False

    def _fuse(self, i: int, c: int) -> None:
        """Fuse the points around keyframe `i` with those around keyframe `c` (rows)."""
        here = np.r_[i, self._atlas.covisible(i, limit=_AROUND)]
        there = np.setdiff1d(np.r_[c, self._atlas.covisible(c, limit=_AROUND)], here)
        for side, other in ((here, there), (there, here)):
            for n in side.tolist():
                fuse(self._atlas, self._camera, n, self._atlas.points_of(other), self._mapping)
        for n in np.r_[here, there].tolist():
            self._atlas.update_connections(n)
        self._atlas.refresh(self._atlas.points_of(np.r_[here, there]))


def merge_maps(atlas: Atlas, i: int, c: int, T_c_i: FloatArray) -> Move:
    """Move the newer of two maps (larger id) into the frame of the older one.

    Return the motion of the newer map's keyframes. In the spanning tree, the matched keyframe of
    the older map becomes the parent of that of the newer map.

    Args:
        i: Row of a keyframe of one map.
        c: Row of a keyframe of the other map.
        T_c_i: (4, 4) measured pose of keyframe `i` relative to keyframe `c`.
    """
    keyframes = atlas.keyframes
    if keyframes.map_id[i] < keyframes.map_id[c]:
        i, c, T_c_i = c, i, se3.inverse(T_c_i)
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == keyframes.map_id[i]))
    T_map_i = keyframes.T_map_camera[c] @ T_c_i
    T_new_old = se3.orthonormalized(T_map_i @ se3.inverse(keyframes.T_map_camera[i]))
    moves = np.tile(T_new_old, (len(rows), 1, 1))
    move = atlas.move(rows, moves, int(keyframes.map_id[c]))
    _reroot(atlas, i, c)
    return move


def _reroot(atlas: Atlas, i: int, parent: int) -> None:
    """Make keyframe `i` the root of its spanning tree, as child of `parent` in another tree."""
    keyframes = atlas.keyframes
    child: int | None = i
    while child is not None:
        old_parent = keyframes.index_of(int(keyframes.parent_uid[child]))
        atlas.set_parent(child, parent)
        parent, child = child, old_parent
