"""The keyframes, points and observations of all maps, and how copies of them are updated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, FloatArray, IntArray
from hoid_native import ObservationGraph, move_points
from hoid_native.results import Observations
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT, KeyframeTable
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_change import (
    Connections,
    FeatureStates,
    MapChange,
    Move,
    PointPositions,
    Redirect,
    Redirects,
)
from rgbd_slam.model.points import PointTable
from rgbd_slam.model.pose_guard import PoseGuard
from rgbd_slam.records.soa_table import DEAD

# Least number of shared points of neighboring keyframes (ORB-SLAM3, KeyFrame.cc,
# UpdateConnections).
NEAR_SHARED = 15


class Anchor(NamedTuple):
    """The keyframe in the map relative to which the pose of another keyframe is known.

    It is that keyframe itself or, if that was removed or is pending, its nearest ancestor in the
    spanning tree.
    """

    row: int | None  # None: this copy of the map has no ancestor yet
    T_anchor_keyframe: FloatArray  # (4, 4); T_map_keyframe if there is no ancestor


_NOTHING = np.empty(0, np.int64)


class MapTables:
    """The tables of a map, with methods that read them and methods that update copies.

    A mapper in another process sends each `MapChange` since the last one, and the tracker applies
    it to its copy between two frames.
    """

    def __init__(self, scale_factor: float, num_octaves: int) -> None:
        self.keyframes = KeyframeTable()
        self.points = PointTable()
        self.version = 1
        self.octave_scale = np.power(scale_factor, np.arange(num_octaves, dtype=np.float64))
        self.guard = PoseGuard()
        self.loops: tuple[LoopEdge, ...] = ()
        self._sent_loops: tuple[LoopEdge, ...] = self.loops
        self.redirects = Redirects()
        # By uid, the oldest first: keyframes that were requested from a mapper in another process
        # and are not in this copy yet.
        self.pending: dict[int, Redirect] = {}
        self.graph = ObservationGraph()
        self._has_copies = False  # whether copies exist that receive the changes
        self._moves: list[Move] = []  # moves since the last change was sent

    def covisible(self, i: int, min_shared: int = 1, limit: int | None = None) -> IntArray:
        """Return the rows (N,) of keyframes that share points with `i`, by descending number.

        At most `limit` rows of keyframes with at least `min_shared` shared points are returned, as
        counted by the last `Atlas.update_connections`.
        """
        return self.graph.neighbors(i, min_shared).rows[:limit]

    def points_of(self, keyframes: IntArray) -> IntArray:
        """Return the ascending rows (P,) of points that any of the keyframes (N,) observes."""
        return self.graph.points_of(self.keyframes.point_of_feature, keyframes)

    def observations_of(self, j: IntArray, keyframes: IntArray | None = None) -> Observations:
        """Return the observations of points `j` (P,) by keyframes; None: by all keyframes.

        They are sorted by keyframe (in the given order, else ascending), then by feature.
        """
        return self.graph.observations(j, keyframes)

    def path_length_m(self, start: int, goal: int, min_shared: int, m_per_rad: float) -> float:
        """Return the length (m) of the shortest path between two keyframes; inf if there is none.

        Keyframes are connected if they share `min_shared` points, or are parent and child in the
        spanning tree. For a rotation by 1 rad, `m_per_rad` is added.
        """
        poses = self.keyframes.T_map_camera
        return self.graph.path_length_m(poses, self.parents(), start, goal, min_shared, m_per_rad)

    def is_connected(self, start: int, goal: int, min_shared: int) -> bool:
        """Return whether a path connects two keyframes, each step sharing `min_shared` points."""
        poses = self.keyframes.T_map_camera
        no_tree = np.full(len(poses), -1)
        length_m = self.graph.path_length_m(poses, no_tree, start, goal, min_shared, 0.0)
        return bool(np.isfinite(length_m))

    def parents(self) -> IntArray:
        """Return the row (capacity,) of each keyframe's parent; -1 for roots and empty rows."""
        kf = self.keyframes
        rows, parents = kf.indices(), np.full(kf.capacity, -1, np.int64)
        parents[rows] = kf.rows_of(kf.parent_uid[rows])
        return parents

    def anchor(self, uid: int) -> Anchor | None:
        """Return the `Anchor` of a keyframe; None if the keyframe is unknown or long removed."""
        T_anchor_keyframe = np.eye(4)
        row = self.keyframes.index_of(uid)
        while row is None:
            link = self.pending.get(uid) or self.redirects.find(uid)
            if link is None:
                return None
            T_anchor_keyframe = link.T_parent_camera @ T_anchor_keyframe
            if link.parent_uid == DEAD:
                break
            uid = link.parent_uid
            row = self.keyframes.index_of(uid)
        return Anchor(row, T_anchor_keyframe)

    def pose(self, uid: int) -> FloatArray | None:
        """Return T_map_keyframe (4, 4), also of a removed or pending keyframe; None if unknown."""
        anchor = self.anchor(uid)
        if anchor is None or anchor.row is None:
            return None if anchor is None else anchor.T_anchor_keyframe
        pose: FloatArray = self.keyframes.T_map_camera[anchor.row] @ anchor.T_anchor_keyframe
        return pose

    def drop_pending(self, uid: int) -> None:
        """Replace a pending keyframe, which the mapper will not insert, by its parent."""
        lost = self.pending.pop(uid, None)
        if lost is not None and lost.parent_uid != DEAD:
            self.redirects.add([lost])

    def changes_since(self, version: int, *, with_features: bool = True) -> MapChange:
        """Return the changes since a version, and start a new version for later changes.

        Redirects, moves and feature states are returned only once. With `with_features=False`,
        features of new keyframes are left out, because the copy already has them.
        """
        change = MapChange(
            self.version,
            tuple(self._moves),
            self.keyframes.rows_since(version, with_features=with_features),
            self.points.rows_since(version),
            self._positions_since(version),
            self._features_since(version),
            self._connections_since(version),
            self.redirects.take(),
            self.guard.take(),
            None if self.loops is self._sent_loops else self.loops,
        )
        self._sent_loops = self.loops
        self._moves, self._has_copies = [], True
        self.version += 1
        return change

    def skip_changes(self) -> int:
        """Discard all changes, because both processes have loaded the map; return its version."""
        self._moves, self._has_copies = [], True
        self.keyframes.is_reobserved[:] = False
        self.redirects.take()
        self._sent_loops = self.loops
        self.version += 1
        return self.version - 1

    def whole(self) -> MapChange:
        """Return the change that makes an empty atlas a copy of this one.

        It has no redirects and no pending keyframes. All feature states then count as sent.
        """
        everything = self.keyframes.rows_since(0), self.points.rows_since(0)
        features = self._features_since(0)
        positions = self._positions_since(self.version)
        connections = self._connections_since(0)
        return MapChange(
            self.version, (), *everything, positions, features, connections, (), 0, self.loops
        )

    def apply(self, change: MapChange, frame: Frame | None = None) -> None:
        """Apply a change to this copy of the map; its keyframes are then not pending any more.

        If the change has no features, `frame` has those of its only new keyframe.
        """
        kf, rows = self.keyframes, change.keyframes.rows
        for move in change.moves:
            self.points.shifted[self._apply_move(move)] = change.version
        kf.put_rows(change.keyframes, change.version)
        if frame is not None:
            for i in change.keyframes.new_rows.tolist():
                kf.put_features(i, frame)
        self.points.put_rows(change.points, change.version)
        self.points.position_m[change.positions.rows] = change.positions.position_m
        self.points.shifted[change.positions.rows] = change.version
        self._apply_features(change.observations)
        kf.reobserved[change.observations.i] = change.version
        self._connect(change.connections)
        for i in rows[kf.uid[rows] == DEAD].tolist():
            self.graph.set_neighbors(i, _NOTHING, _NOTHING)
        self.version = change.version
        self.redirects.add(change.redirects)
        self.guard.num_refused += change.num_refused
        if change.loops is not None:
            self.loops = self._sent_loops = change.loops
        for uid in list(self.pending):
            if kf.index_of(uid) is not None or self.redirects.find(uid) is not None:
                del self.pending[uid]

    def _apply_move(self, move: Move) -> BoolArray:
        """Move keyframes with their points; return the mask (capacity,) of the moved points."""
        kf, points = self.keyframes, self.points
        rows = kf.rows_of(move.uids)
        n = np.flatnonzero(rows >= 0)
        rows = rows[n]
        kf.T_map_camera[rows] = move.T_new_old[n] @ kf.T_map_camera[rows]
        which_of_uid = np.full(int(move.uids.max(initial=0)) + 1, -1, np.int64)
        which_of_uid[move.uids] = np.arange(len(move.uids))
        reference = points.reference_keyframe_uid
        is_known = points.alive & (reference < len(which_of_uid))
        which = np.where(is_known, which_of_uid[np.where(is_known, reference, 0)], -1)
        move_points(move.T_new_old, which, points.position_m, points.view_direction)
        if move.map_id is not None:
            kf.map_id[rows] = points.map_id[which >= 0] = move.map_id
        return np.asarray(which >= 0)

    def _positions_since(self, version: int) -> PointPositions:
        """Return the positions that changed after `version`, of points with no other changes."""
        points = self.points
        rows = np.flatnonzero((points.shifted > version) & (points.version <= version))
        rows = rows[points.uid[rows] != DEAD]
        return PointPositions(rows.astype(np.int32), points.position_m[rows])

    def _mark_features(self, i: int | IntArray, k: IntArray) -> None:
        """Mark features `k` of keyframes `i` as changed, so that copies receive them."""
        self.keyframes.reobserved[i] = self.version
        self.keyframes.is_reobserved[i, k] = True

    def _features_since(self, version: int) -> FeatureStates:
        """Return the unsent feature states that changed after `version`, and mark them as sent.

        For version 0, return the states of all features that observe a point.
        """
        kf = self.keyframes
        if version == 0:
            kf.is_reobserved[:] = False
            return self._feature_states(*np.nonzero(kf.point_of_feature != NO_POINT))
        rows = np.flatnonzero(kf.reobserved > version)
        n, k = np.nonzero(kf.is_reobserved[rows])
        kf.is_reobserved[rows] = False
        return self._feature_states(rows[n], k)

    def _feature_states(self, i: IntArray, k: IntArray) -> FeatureStates:
        kf = self.keyframes
        i32, k32 = i.astype(np.int32), k.astype(np.int32)
        return FeatureStates(i32, k32, kf.point_of_feature[i, k], kf.may_seed[i, k])

    def _apply_features(self, states: FeatureStates) -> None:
        kf = self.keyframes
        i, k, new = (part.astype(np.int64) for part in states[:3])
        old = kf.point_of_feature[i, k].astype(np.int64)
        gone, seen = old != NO_POINT, new != NO_POINT
        self.graph.unobserve(i[gone], k[gone], old[gone])
        self.graph.observe(i[seen], k[seen], new[seen])
        kf.point_of_feature[i, k] = new
        kf.may_seed[i, k] = states.may_seed

    def _connections_since(self, version: int) -> Connections:
        rows = np.flatnonzero(self.keyframes.alive & (self.keyframes.connected > version))
        found = [self.graph.neighbors(i) for i in rows.tolist()]
        return Connections(
            rows,
            np.array([len(near.rows) for near in found], np.int64),
            np.concatenate([_NOTHING, *(near.rows for near in found)]),
            np.concatenate([_NOTHING, *(near.shared for near in found)]),
        )

    def _connect(self, connections: Connections) -> None:
        ends = np.cumsum(connections.lengths).tolist()
        starts = [0, *ends]
        for i, start, end in zip(connections.rows.tolist(), starts, ends, strict=False):
            rows, shared = connections.neighbors[start:end], connections.shared[start:end]
            order = np.argsort(rows)
            self.graph.set_neighbors(i, rows[order], shared[order])

    def _set_neighbors(self, i: int, rows: IntArray, shared: IntArray) -> None:
        self.graph.set_neighbors(i, rows, shared)
        self.keyframes.connected[i] = self.version
