"""The atlas: keyframes and points of all maps, and the operations that keep them consistent.

An observation is a triple `(i, k, j)`: keyframe i observes point j in its feature k.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from hoid_native import point_statistics
from hoid_native.results import Observations
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.loop_edge import moved_ends
from rgbd_slam.model.map_change import Move, Redirect
from rgbd_slam.model.map_tables import MapTables
from rgbd_slam.model.points import MAX_POSITION_M, PointCounts
from rgbd_slam.records.soa_table import DEAD, Column

# Chosen: number of points that are refreshed at once, so that their observations fit the cache.
_REFRESHED = 5000
_NOTHING = np.empty(0, np.int64)


class Atlas(MapTables):
    """Keyframes and points of all maps. After tracking is lost, a new map may be started.

    Only the mapper writes to an `Atlas`. If the mapper runs in another process, the tracker has a
    copy, to which it applies the mapper's `MapChange`s between two frames.
    """

    def clear(self) -> None:
        keyframes, points = self.keyframes, self.points
        self._mark_features(*np.nonzero(keyframes.point_of_feature != NO_POINT))
        keyframes.point_of_feature[:] = NO_POINT
        self.graph.clear()
        keyframes.release(keyframes.indices(), self.version)
        points.release(points.indices(), self.version)
        self.redirects.clear()
        self.pending.clear()
        self._moves.clear()
        self.loops = ()

    # ---- keyframes

    def add_keyframe(
        self,
        frame: Frame,
        T_map_camera: FloatArray,
        map_id: int,
        parent: int | None = None,
        uid: int | None = None,
    ) -> int:
        """Store a keyframe without observations; return its row.

        `parent` is the row of its parent in the spanning tree; None: it is the first keyframe of a
        map. `uid` must be new; None: the next unused one.
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
        """Set the poses T_map_camera (N, 4, 4) of keyframes, except invalid ones (`PoseGuard`)."""
        is_valid = self.guard.are_valid(T_map_camera, 'keyframes')
        i, T_map_camera = i[is_valid], T_map_camera[is_valid]
        self.keyframes.T_map_camera[i] = T_map_camera
        self.keyframes.version[i] = self.version

    def set_parent(self, i: int, parent: int | None) -> None:
        """Make keyframe `parent` the parent of keyframe `i`; None: `i` is the root of its map."""
        self.keyframes.parent_uid[i] = DEAD if parent is None else self.keyframes.uid[parent]
        self.keyframes.version[i] = self.version

    def move(self, i: IntArray, T_new_old: FloatArray, map_id: int | None = None) -> Move:
        """Move keyframes (N,) by motions (N, 4, 4), with the points that refer to them.

        Return the motions as applied: made exactly rigid, because rounding errors of poses would
        triple with each loop. Copies of the map receive only the motions, not the moved points.
        Keyframes with an invalid motion are not moved (`PoseGuard`). With `map_id`, keyframes and
        points then belong to that map.
        """
        is_valid = self.guard.are_valid(T_new_old, 'keyframes')
        i, T_new_old = i[is_valid], T_new_old[is_valid]
        move = Move(self.keyframes.uid[i], se3.orthonormalized(T_new_old), map_id)
        if self._has_copies:
            self._moves.append(move)
        self._apply_move(move)
        return move

    def remove_keyframe(self, i: int) -> None:
        """Remove a keyframe; its parent takes its place in the spanning tree.

        Points that no other keyframe observes are removed too. A `Redirect` makes poses relative
        to the keyframe relative to the parent. ValueError for the root of a map, which has no
        parent.
        """
        kf = self.keyframes
        parent = kf.index_of(int(kf.parent_uid[i]))
        if parent is None:
            raise ValueError(f'keyframe {i} is the root of its map and cannot be removed')
        self.unobserve(i, np.flatnonzero(kf.point_of_feature[i] != NO_POINT))
        T_parent_camera = se3.inverse(kf.T_map_camera[parent]) @ kf.T_map_camera[i]
        redirect = Redirect(int(kf.uid[i]), int(kf.uid[parent]), T_parent_camera)
        self.redirects.add([redirect])
        if any(redirect.uid in edge[:2] for edge in self.loops):
            self.loops = moved_ends(self.loops, *redirect)
        children = kf.children(i)
        kf.parent_uid[children] = kf.uid[parent]
        kf.version[children] = self.version
        self._set_neighbors(i, _NOTHING, _NOTHING)
        kf.release(np.array([i]), self.version)

    def update_connections(self, i: int) -> None:
        """Count again how many points keyframe `i` shares with each other keyframe."""
        seen = self.keyframes.points_of(i)
        self.graph.connect(i, seen[seen != NO_POINT])
        self.keyframes.connected[i] = self.version

    # ---- points and observations

    def add_points(self, i: int, k: IntArray, position_m: FloatArray) -> IntArray:
        """Create points at positions (N, 3) in features of keyframe `i`; return their rows."""
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
        """Set the positions (N, 3) of points; remove those that are NaN or too far away.

        Bundle adjustment may move a point without parallax and depth to any distance.
        """
        self.points.position_m[j] = position_m
        self.points.shifted[j] = self.version
        is_near = (np.abs(position_m) < MAX_POSITION_M).all(axis=1)  # False for NaN
        if not is_near.all():
            self.points.position_m[j[~is_near]] = 0.0
            self.remove_points(j[~is_near])

    def observe(self, i: int, k: IntArray, j: IntArray) -> None:
        """Add observations: feature `k[n]` of keyframe `i` observes point `j[n]`, for N pairs.

        The features must not observe a point yet, nor the keyframe any of these points.
        """
        kf, points = self.keyframes, self.points
        self._mark_features(i, k)
        kf.point_of_feature[i, k] = j
        self.graph.observe(np.full(len(k), i), k, j)
        points.num_observations[j] += 1
        points.num_stereo[j] += kf.depth_m[i, k] > 0
        points.version[j] = self.version

    def unobserve(self, i: int, k: IntArray) -> None:
        """Remove the observations, if any, of features `k` (N,) of keyframe `i`.

        Points without observations are removed; points whose reference keyframe is `i` get
        another.
        """
        kf, points = self.keyframes, self.points
        k = k[kf.point_of_feature[i, k] != NO_POINT]
        j = kf.point_of_feature[i, k].astype(np.int64)
        self.graph.unobserve(np.full(len(k), i), k, j)
        points.num_observations[j] -= 1
        points.num_stereo[j] -= kf.depth_m[i, k] > 0
        self._mark_features(i, k)
        kf.point_of_feature[i, k] = NO_POINT
        points.version[j] = self.version
        points.release(j[points.num_observations[j] == 0], self.version)
        # The reference keyframe of a point always observes it, so that both move together.
        self.refresh(j[points.reference_keyframe_uid[j] == kf.uid[i]])

    def forbid_seeds(self, i: int, k: IntArray) -> None:
        """Forbid features `k` (N,) of keyframe `i` to create points."""
        self._mark_features(i, k)
        self.keyframes.may_seed[i, k] = False

    def remove_points(self, j: IntArray) -> None:
        seen = self.observations_of(j)
        self.graph.unobserve(*seen)
        self._mark_features(seen.i, seen.k)
        self.keyframes.point_of_feature[seen.i, seen.k] = NO_POINT
        self.points.release(j, self.version)

    def replace_points(self, old: IntArray, new: IntArray) -> None:
        """Fuse points: observations of row `old[n]` become observations of row `new[n]`.

        A keyframe that observes several of the fused points keeps one observation, preferably that
        of `new[n]`. Call `refresh` afterwards. Rows in `old` are unique, and not in `new`.
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
        self._mark_features(seen.i, seen.k)
        kf.point_of_feature[seen.i, seen.k] = np.where(moves, to, NO_POINT)
        self.graph.unobserve(*seen)
        self.graph.observe(seen.i[moves], seen.k[moves], to[moves])
        np.add.at(points.num_observations, to[moves], 1)
        np.add.at(points.num_stereo, to[moves], kf.depth_m[seen.i[moves], seen.k[moves]] > 0)
        np.add.at(points.num_visible, new, points.num_visible[old])
        np.add.at(points.num_found, new, points.num_found[old])
        points.version[new] = self.version
        points.release(old, self.version)

    def refresh(self, j: IntArray) -> None:
        """Recompute viewing direction, scale range and descriptor of points `j` (P,).

        A point that its reference keyframe does not observe any more gets another reference
        keyframe. Rows of removed points are skipped.
        """
        points = self.points
        seen = self.graph.observations_by_point(j[points.uid[j] != DEAD])
        if len(seen.j) == 0:
            return
        kf = self.keyframes
        new = point_statistics(
            kf.T_map_camera,
            kf.uid,
            kf.octave,
            kf.descriptors,
            points.position_m,
            points.reference_keyframe_uid,
            *seen,
            self.octave_scale,
        )
        points.view_direction[new.rows] = new.view_direction
        points.reference_keyframe_uid[new.rows] = kf.uid[new.reference]
        points.max_distance_m[new.rows] = new.max_distance_m
        points.min_distance_m[new.rows] = new.max_distance_m / self.octave_scale[-1]
        points.descriptors[new.rows] = new.descriptors
        points.version[new.rows] = self.version

    def add_point_counts(self, counts: PointCounts) -> None:
        """Add how many frames should have shown points, and in how many the points were found."""
        points = self.points
        same = points.uid[counts.points] == counts.uids
        j = counts.points[same]
        points.num_visible[j] += counts.visible[same]
        points.num_found[j] += counts.found[same]
        points.version[j] = self.version

    # ---- saved maps

    def make_younger(self, by: int) -> None:
        """Add `by` to the ids of all maps, so that older maps can be added with lower ids."""
        keyframes, points = self.keyframes, self.points
        i, j = keyframes.indices(), points.indices()
        keyframes.map_id[i] += by
        points.map_id[j] += by
        keyframes.version[i] = points.version[j] = self.version

    def append_keyframes(
        self,
        columns: Mapping[str, Column],
        parent: IntArray,
        features: Mapping[str, Column],
        first_uid: int | None = None,
    ) -> IntArray:
        """Add N keyframes of an earlier session, without observations; return their rows (N,).

        `columns` (N, ...) belong to the keyframes, `features` (F, ...) to their features, sorted
        by keyframe. `parent` (N,) has the index of each parent among the keyframes, or DEAD. The
        uids count from `first_uid` on; None: from the next unused one.
        """
        kf = self.keyframes
        kf.reserve_features(int(columns['num_features'].max()))
        i = kf.append(columns, self.version, first_uid)
        kf.is_loaded[i] = True
        kf.parent_uid[i] = np.where(parent == DEAD, DEAD, kf.uid[i[parent]])
        kf.point_of_feature[i] = NO_POINT
        kf.append_features(i, features)
        return i

    def adopt(
        self, loaded: Atlas, version: int, uid_offset: int, *, keep_pending: bool = False
    ) -> None:
        """Exchange the content of this atlas with that of another atlas, a restored map.

        The tables stay the same objects, because others refer to them. The old content is not
        freed here, because that takes 90 ms for 10,000 keyframes. `uid_offset` is added to the
        uids of the points, which then are those of the mapper.
        """
        for table, new in ((self.keyframes, loaded.keyframes), (self.points, loaded.points)):
            if new.capacity < table.capacity:  # rows of the old map may still be looked up
                new.grow(table.capacity)
            new.version[:] = new.born[:] = version
            old = dict(vars(table))
            vars(table).update(vars(new))
            vars(new).update(old)
        self.points.shift_uids(uid_offset)
        self.graph, loaded.graph = loaded.graph, self.graph
        self.loops = self._sent_loops = loaded.loops
        if not keep_pending:
            self.pending.clear()
        self._moves.clear()
        self.version = version

    def append_points(self, columns: Mapping[str, Column], reference: IntArray) -> IntArray:
        """Add saved points with reference keyframes in rows (N,); return their rows (N,)."""
        points, kf = self.points, self.keyframes
        j = points.append(columns, self.version)
        points.reference_keyframe_uid[j] = points.first_keyframe_uid[j] = kf.uid[reference]
        points.map_id[j] = kf.map_id[reference]
        return j

    def append_observations(self, blocks: Iterable[Observations], points: IntArray) -> None:
        """Add the observations of appended points, which are in ascending rows (P,).

        The columns of the points already count these observations. Connections of the keyframes
        and statistics of the points are computed here. The observations are in blocks, sorted by
        keyframe, so that no call holds the interpreter lock for long.
        """
        rows = []
        for seen in blocks:
            self._mark_features(seen.i, seen.k)
            self.keyframes.point_of_feature[seen.i, seen.k] = seen.j
            self.graph.observe(*seen)
            rows += np.unique(seen.i).tolist()
        for i in sorted(rows):
            self.update_connections(i)
        for start in range(0, len(points), _REFRESHED):
            self.refresh(points[start : start + _REFRESHED])
        self.keyframes.release_memory()
