"""The atlas: keyframes and points of all maps, and the operations that keep them consistent.

An `Atlas` has one writer. Offline this is the mapper in the same process. Live the mapper has its
own atlas in a separate process and sends `MapChange`s (the rows that changed since the last one),
which the tracker applies to its copy between two frames. An observation is a triple `(i, k, j)`:
keyframe i observes point j in its feature k.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from hoid_native import ObservationGraph, move_points
from hoid_native.results import Edges, Observations
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT, KeyframeTable, SavedKeyframes
from rgbd_slam.model.map_change import (
    Connections,
    FeatureStates,
    MapChange,
    Move,
    PendingKeyframe,
    PointPositions,
    Redirect,
    Redirects,
)
from rgbd_slam.model.point_statistics import point_statistics
from rgbd_slam.model.points import PointCounts, PointTable
from rgbd_slam.model.soa_table import DEAD, Column


class Anchor(NamedTuple):
    """The pose of a keyframe relative to itself in the map, or to its nearest ancestor there."""

    row: int | None  # None: no ancestor is in this copy of the map yet
    T_anchor_keyframe: FloatArray  # (4, 4); T_map_keyframe without an ancestor


_REFRESHED = 5000  # chosen: points that are refreshed at once, whose observations fit the cache
_NOTHING = np.empty(0, np.int64)


class Atlas:
    """Keyframes and points of all maps; after a loss, a new map (`map_id`) may be started."""

    def __init__(self, scale_factor: float, num_octaves: int) -> None:
        self.keyframes = KeyframeTable()
        self.points = PointTable()
        self.version = 1
        self.octave_scale = np.power(scale_factor, np.arange(num_octaves, dtype=np.float64))
        self.redirects = Redirects()
        # Keyframes that were requested from a mapper in another process and are not in this copy
        # yet, by uid, the oldest first.
        self.pending: dict[int, PendingKeyframe] = {}
        self._graph = ObservationGraph()
        self._moves: list[Move] = []  # since the last change was sent

    def clear(self) -> None:
        """Remove all keyframes and points; poses relative to them become undefined."""
        keyframes, points = self.keyframes, self.points
        self._note_features(*np.nonzero(keyframes.point_of_feature != NO_POINT))
        keyframes.point_of_feature[:] = NO_POINT
        self._graph.clear()
        keyframes.release(keyframes.indices(), self.version)
        points.release(points.indices(), self.version)
        self.redirects.clear()
        self.pending.clear()
        self._moves.clear()

    # ---- keyframes

    def add_keyframe(
        self,
        frame: Frame,
        T_map_camera: FloatArray,
        map_id: int,
        parent: int | None = None,
        uid: int | None = None,
    ) -> int:
        """Store a keyframe without observations and return its row.

        Args:
            frame: Its features.
            T_map_camera: (4, 4) its pose.
            map_id: The map that it belongs to.
            parent: Its parent in the spanning tree; None for the first keyframe of a map.
            uid: Its uid; None: the next unused one.
        """
        kf = self.keyframes
        i = int(kf.allocate(1, self.version, uid)[0])
        kf.store_features(i, frame)
        kf.T_map_camera[i] = T_map_camera
        kf.map_id[i] = map_id
        kf.is_loaded[i] = False
        kf.parent_uid[i] = DEAD if parent is None else kf.uid[parent]
        self._set_neighbors(i, _NOTHING, _NOTHING)
        return i

    def set_poses(self, i: IntArray, T_map_camera: FloatArray) -> None:
        """Set the poses (N, 4, 4) of keyframes (N,)."""
        self.keyframes.T_map_camera[i] = T_map_camera
        self.keyframes.version[i] = self.version

    def set_parent(self, i: int, parent: int) -> None:
        """Set the parent of a keyframe in the spanning tree."""
        self.keyframes.parent_uid[i] = self.keyframes.uid[parent]
        self.keyframes.version[i] = self.version

    def move(self, i: IntArray, T_new_old: FloatArray, map_id: int | None = None) -> Move:
        """Move keyframes (N,) by rigid motions (N, 4, 4), with the points that refer to them.

        Only the motions are sent to the copies of the map, not the points. They are returned.

        Args:
            i: (N,) keyframes.
            T_new_old: (N, 4, 4) motions in the map frame.
            map_id: The map that they belong to from now on; None: as before.
        """
        move = Move(self.keyframes.uid[i], T_new_old, map_id)
        self._moves.append(move)
        self._apply_move(move)
        return move

    def _apply_move(self, move: Move) -> None:
        kf, points = self.keyframes, self.points
        rows = kf.indices()
        rows = rows[np.isin(kf.uid[rows], move.uids)]
        order = np.argsort(move.uids)
        n = order[np.searchsorted(move.uids, kf.uid[rows], sorter=order)]
        kf.T_map_camera[rows] = move.T_new_old[n] @ kf.T_map_camera[rows]
        which_of_uid = np.full(int(move.uids.max(initial=0)) + 1, -1, np.int64)
        which_of_uid[move.uids] = np.arange(len(move.uids))
        reference = points.reference_keyframe_uid
        is_known = points.alive & (reference < len(which_of_uid))
        which = np.where(is_known, which_of_uid[np.where(is_known, reference, 0)], -1)
        move_points(move.T_new_old, which, points.position_m, points.view_direction)
        if move.map_id is not None:
            kf.map_id[rows] = points.map_id[which >= 0] = move.map_id

    def remove_keyframe(self, i: int) -> None:
        """Remove a keyframe; its children and the frames relative to it move to its parent.

        Raises:
            ValueError: The keyframe is the root of its map, which has no parent.
        """
        kf = self.keyframes
        parent = kf.index_of(int(kf.parent_uid[i]))
        if parent is None:
            raise ValueError(f'keyframe {i} is the root of its map and cannot be removed')
        self.unobserve(i, np.flatnonzero(kf.point_of_feature[i] != NO_POINT))
        T_parent_camera = se3.inverse(kf.T_map_camera[parent]) @ kf.T_map_camera[i]
        self.redirects.add([Redirect(int(kf.uid[i]), int(kf.uid[parent]), T_parent_camera)])
        children = kf.children(i)
        kf.parent_uid[children] = kf.uid[parent]
        kf.version[children] = self.version
        self._set_neighbors(i, _NOTHING, _NOTHING)
        kf.release(np.array([i]), self.version)

    def update_connections(self, i: int) -> None:
        """Recount the points that keyframe `i` shares with every other keyframe."""
        seen = self.keyframes.points_of(i)
        self._graph.connect(i, seen[seen != NO_POINT])
        self.keyframes.connected[i] = self.version

    def covisible(self, i: int, min_shared: int = 1, limit: int | None = None) -> IntArray:
        """Return (N,) keyframes that share at least `min_shared` points with `i`, most first."""
        return self._graph.neighbors(i, min_shared).rows[:limit]

    def edges(self) -> Edges:
        """Return all pairs of keyframes that share points, by first and second row."""
        return self._graph.edges()

    def points_of(self, keyframes: IntArray) -> IntArray:
        """Return the (P,) points, ascending, that any of the keyframes (N,) observes."""
        return self._graph.points_of(self.keyframes.point_of_feature, keyframes)

    def count_observed(self, j: IntArray, keyframes: IntArray) -> IntArray:
        """Return how many of the points (P,) each of the keyframes (N,) observes."""
        return self._graph.count_observed(j, keyframes)

    def path_length_m(self, start: int, goal: int, min_shared: int, m_per_rad: float) -> float:
        """Return the length of the shortest path in the covisibility graph and spanning tree.

        See `hoid_native.ObservationGraph.path_length_m`.
        """
        kf = self.keyframes
        poses = kf.T_map_camera
        return self._graph.path_length_m(poses, self.parents(), start, goal, min_shared, m_per_rad)

    def parents(self) -> IntArray:
        """Return the (capacity,) row of each keyframe's parent, or -1."""
        kf = self.keyframes
        rows = kf.indices()
        order = rows[np.argsort(kf.uid[rows])]
        uids, wanted = kf.uid[order], kf.parent_uid[rows]
        at = np.minimum(np.searchsorted(uids, wanted), max(len(rows) - 1, 0))
        parents = np.full(kf.capacity, -1, np.int64)
        parents[rows] = np.where(uids[at] == wanted, order[at], -1)
        return parents

    def _set_neighbors(self, i: int, rows: IntArray, shared: IntArray) -> None:
        self._graph.set_neighbors(i, rows, shared)
        self.keyframes.connected[i] = self.version

    def anchor(self, uid: int) -> Anchor | None:
        """Return where a keyframe is in the map, even if it was removed or is still pending.

        None is returned if nothing is known of it.
        """
        T_anchor_keyframe = np.eye(4)
        row = self.keyframes.index_of(uid)
        while row is None:
            link = self.pending.get(uid) or self.redirects.find(uid)
            if link is None:
                return None
            T_anchor_keyframe = link.T_parent_camera @ T_anchor_keyframe
            if link.parent_uid is None:
                break
            uid = link.parent_uid
            row = self.keyframes.index_of(uid)
        return Anchor(row, T_anchor_keyframe)

    def pose(self, uid: int) -> FloatArray | None:
        """Return T_map_keyframe (4, 4) of a keyframe, also of a removed or pending one."""
        anchor = self.anchor(uid)
        if anchor is None or anchor.row is None:
            return None if anchor is None else anchor.T_anchor_keyframe
        pose: FloatArray = self.keyframes.T_map_camera[anchor.row] @ anchor.T_anchor_keyframe
        return pose

    def drop_pending(self, uid: int) -> None:
        """Replace a pending keyframe, which will not come, by its parent."""
        lost = self.pending.pop(uid, None)
        if lost is not None and lost.parent_uid is not None:
            self.redirects.add([Redirect(lost.uid, lost.parent_uid, lost.T_parent_camera)])

    # ---- points and observations

    def add_points(self, i: int, k: IntArray, position_m: FloatArray) -> IntArray:
        """Create points at (N, 3), observed in features `k` of keyframe `i`; return their rows."""
        points = self.points
        j = points.allocate(len(k), self.version)
        points.position_m[j] = position_m
        for column in (points.num_observations, points.num_stereo):
            column[j] = 0
        for column in (points.num_visible, points.num_found):
            column[j] = 1
        points.first_keyframe_uid[j] = points.reference_keyframe_uid[j] = self.keyframes.uid[i]
        points.map_id[j] = self.keyframes.map_id[i]
        self.observe(i, k, j)
        self.refresh(j)
        return j

    def set_positions(self, j: IntArray, position_m: FloatArray) -> None:
        """Set the positions (N, 3) of points (N,)."""
        self.points.position_m[j] = position_m
        self.points.shifted[j] = self.version

    def observe(self, i: int, k: IntArray, j: IntArray) -> None:
        """Add the observations of points `j` in features `k` of keyframe `i`, both free before."""
        kf, points = self.keyframes, self.points
        self._note_features(i, k)
        kf.point_of_feature[i, k] = j
        self._graph.observe(np.full(len(k), i), k, j)
        points.num_observations[j] += 1
        points.num_stereo[j] += kf.depth_m[i, k] > 0
        points.version[j] = self.version

    def unobserve(self, i: int, k: IntArray) -> None:
        """Remove the observations of features `k` of `i`, and points that have none left."""
        kf, points = self.keyframes, self.points
        k = k[kf.point_of_feature[i, k] != NO_POINT]
        j = kf.point_of_feature[i, k].astype(np.int64)
        self._graph.unobserve(np.full(len(k), i), k, j)
        points.num_observations[j] -= 1
        points.num_stereo[j] -= kf.depth_m[i, k] > 0
        self._note_features(i, k)
        kf.point_of_feature[i, k] = NO_POINT
        points.version[j] = self.version
        points.release(j[points.num_observations[j] == 0], self.version)
        # The reference keyframe of a point always observes it, so that the point moves with it.
        self.refresh(j[points.reference_keyframe_uid[j] == kf.uid[i]])

    def forbid_seeds(self, i: int, k: IntArray) -> None:
        """Forbid that features `k` of `i` create points from now on."""
        self._note_features(i, k)
        self.keyframes.may_seed[i, k] = False

    def observations_of(self, j: IntArray, keyframes: IntArray | None = None) -> Observations:
        """Return the observations of points `j` by `keyframes` (or all), sorted by i and k."""
        return self._graph.observations(j, keyframes)

    def remove_points(self, j: IntArray) -> None:
        """Remove points with all their observations."""
        seen = self.observations_of(j)
        self._graph.unobserve(*seen)
        self._note_features(seen.i, seen.k)
        self.keyframes.point_of_feature[seen.i, seen.k] = NO_POINT
        self.points.release(j, self.version)

    def replace_points(self, old: IntArray, new: IntArray) -> None:
        """Fuse points: observations of `old[n]` become observations of `new[n]`.

        A keyframe that observes both keeps its observation of `new[n]` alone. `old` and `new` are
        disjoint, and `old` has no repetitions.
        """
        if len(old) == 0:
            return
        kf, points = self.keyframes, self.points
        seen = self.observations_of(old)
        order = np.argsort(old)
        to = new[order][np.searchsorted(old, seen.j, sorter=order)]
        have = self.observations_of(np.unique(new))
        key_have = have.i * points.capacity + have.j
        key = seen.i * points.capacity + to
        _, first = np.unique(key, return_index=True)
        moves = np.zeros(len(key), np.bool_)
        moves[first] = True
        moves &= ~np.isin(key, key_have)
        self._note_features(seen.i, seen.k)
        kf.point_of_feature[seen.i, seen.k] = np.where(moves, to, NO_POINT)
        self._graph.unobserve(*seen)
        self._graph.observe(seen.i[moves], seen.k[moves], to[moves])
        np.add.at(points.num_observations, to[moves], 1)
        np.add.at(points.num_stereo, to[moves], kf.depth_m[seen.i[moves], seen.k[moves]] > 0)
        np.add.at(points.num_visible, new, points.num_visible[old])
        np.add.at(points.num_found, new, points.num_found[old])
        points.version[new] = self.version
        points.release(old, self.version)

    def refresh(self, j: IntArray) -> None:
        """Recompute viewing direction, scale range and descriptor of the live points among `j`."""
        points = self.points
        seen = self.observations_of(j[points.uid[j] != DEAD])
        if len(seen.j) == 0:
            return
        new = point_statistics(self.keyframes, points, seen, self.octave_scale)
        points.view_direction[new.rows] = new.view_direction
        points.reference_keyframe_uid[new.rows] = new.reference_keyframe_uid
        points.max_distance_m[new.rows] = new.max_distance_m
        points.min_distance_m[new.rows] = new.max_distance_m / self.octave_scale[-1]
        points.descriptors[new.rows] = new.descriptors
        points.version[new.rows] = self.version

    def count_sightings(self, counts: PointCounts) -> None:
        """Add how often points were visible and found; points that were removed are skipped."""
        points = self.points
        same = points.uid[counts.points] == counts.uids
        j = counts.points[same]
        points.num_visible[j] += counts.visible[same]
        points.num_found[j] += counts.found[same]
        points.version[j] = self.version

    # ---- saved maps

    def make_younger(self, by: int) -> None:
        """Increase the ids of all maps, so that older maps can be added with lower ids."""
        keyframes, points = self.keyframes, self.points
        i, j = keyframes.indices(), points.indices()
        keyframes.map_id[i] += by
        points.map_id[j] += by
        keyframes.version[i] = points.version[j] = self.version

    def append_keyframes(self, saved: SavedKeyframes, first_uid: int | None = None) -> IntArray:
        """Add keyframes of an earlier session and return their (N,) rows.

        Args:
            saved: The keyframes.
            first_uid: The uid of the first one; None: the next unused one.
        """
        kf = self.keyframes
        kf.reserve_features(int(saved.columns['num_features'].max()))
        i = kf.append(saved.columns, self.version, first_uid)
        kf.is_loaded[i] = True
        kf.parent_uid[i] = np.where(saved.parent == DEAD, DEAD, kf.uid[i[saved.parent]])
        kf.point_of_feature[i] = NO_POINT
        kf.append_features(i[saved.keyframe], saved.feature, saved.features)
        return i

    def append_points(self, columns: Mapping[str, Column], reference: IntArray) -> IntArray:
        """Add points of an earlier session and return their (N,) rows.

        Args:
            columns: (N, ...) columns of the points.
            reference: (N,) rows of their reference keyframes.
        """
        points, kf = self.points, self.keyframes
        j = points.append(columns, self.version)
        points.reference_keyframe_uid[j] = points.first_keyframe_uid[j] = kf.uid[reference]
        points.map_id[j] = kf.map_id[reference]
        return j

    def append_observations(self, seen: Observations) -> None:
        """Add the observations of appended points, whose columns already count them."""
        self._note_features(seen.i, seen.k)
        self.keyframes.point_of_feature[seen.i, seen.k] = seen.j
        self._graph.observe(*seen)
        for i in np.flatnonzero(np.bincount(seen.i)).tolist():
            self.update_connections(i)
        points = np.flatnonzero(np.bincount(seen.j))
        for start in range(0, len(points), _REFRESHED):
            self.refresh(points[start : start + _REFRESHED])

    # ---- copies in other processes

    def changes_since(self, version: int, *, with_features: bool = True) -> MapChange:
        """Return what changed after `version`, and start a new version for later changes.

        Args:
            version: The version of the copy that the change will be applied to.
            with_features: False: the copy has the features of the only new keyframe.
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
        )
        self._moves = []
        self.version += 1
        return change

    def whole(self) -> MapChange:
        """Return the change that makes an empty atlas equal to this one."""
        everything = self.keyframes.rows_since(0), self.points.rows_since(0)
        features = self._features_since(0)
        positions = self._positions_since(self.version)
        return MapChange(
            self.version, (), *everything, positions, features, self._connections_since(0), ()
        )

    def apply(self, change: MapChange, frame: Frame | None = None) -> None:
        """Apply a change to this copy, and add the redirects of the change to its own.

        Args:
            change: The change.
            frame: The features of the only new keyframe, if the change does not have them.
        """
        kf, rows = self.keyframes, change.keyframes.rows
        for move in change.moves:
            self._apply_move(move)
        kf.put_rows(change.keyframes, change.version)
        if frame is not None:
            for i in change.keyframes.new_rows.tolist():
                kf.put_features(i, frame)
        self.points.put_rows(change.points, change.version)
        self.points.position_m[change.positions.rows] = change.positions.position_m
        self._apply_features(change.observations)
        self._connect(change.connections)
        for i in rows[kf.uid[rows] == DEAD].tolist():
            self._graph.set_neighbors(i, _NOTHING, _NOTHING)
        self.version = change.version
        self.redirects.add(change.redirects)
        for uid in list(self.pending):
            if kf.index_of(uid) is not None or self.redirects.find(uid) is not None:
                del self.pending[uid]

    def _positions_since(self, version: int) -> PointPositions:
        """Return the positions of points of which nothing else has changed after `version`."""
        points = self.points
        rows = np.flatnonzero((points.shifted > version) & (points.version <= version))
        rows = rows[points.uid[rows] != DEAD]
        return PointPositions(rows.astype(np.int32), points.position_m[rows])

    def _note_features(self, i: int | IntArray, k: IntArray) -> None:
        """Note that the states of features `k` of keyframes `i` must be sent to the copies."""
        self.keyframes.reobserved[i] = self.version
        self.keyframes.is_reobserved[i, k] = True

    def _features_since(self, version: int) -> FeatureStates:
        """Return the states of features that changed after the last call with this version.

        Since version 0, these are all features that observe a point.
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
        """Set the states of features to those of another copy."""
        kf = self.keyframes
        i, k, new = (part.astype(np.int64) for part in states[:3])
        old = kf.point_of_feature[i, k].astype(np.int64)
        gone, seen = old != NO_POINT, new != NO_POINT
        self._graph.unobserve(i[gone], k[gone], old[gone])
        self._graph.observe(i[seen], k[seen], new[seen])
        kf.point_of_feature[i, k] = new
        kf.may_seed[i, k] = states.may_seed

    def _connections_since(self, version: int) -> Connections:
        """Return the connections that were counted after `version`."""
        rows = np.flatnonzero(self.keyframes.alive & (self.keyframes.connected > version))
        found = [self._graph.neighbors(i) for i in rows.tolist()]
        return Connections(
            rows,
            np.array([len(near.rows) for near in found], np.int64),
            np.concatenate([_NOTHING, *(near.rows for near in found)]),
            np.concatenate([_NOTHING, *(near.shared for near in found)]),
        )

    def _connect(self, connections: Connections) -> None:
        """Set the connections of keyframes to those of another copy."""
        ends = np.cumsum(connections.lengths).tolist()
        starts = [0, *ends]
        for i, start, end in zip(connections.rows.tolist(), starts, ends, strict=False):
            rows, shared = connections.neighbors[start:end], connections.shared[start:end]
            order = np.argsort(rows)
            self._graph.set_neighbors(i, rows[order], shared[order])
