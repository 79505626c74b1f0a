"""The map: keyframes, points, and the rules that keep the two consistent.

`Atlas` has one writer. Offline that is the mapper in the same process. Live the mapper owns the
map in a process of its own and sends `MapChange`s (the rows that changed since the last one); the
tracker applies them to its copy between two frames. Observations are `(i, k, j)`: keyframe i sees
point j in its feature k.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT, KeyframeTable, Observations, SavedKeyframes
from rgbd_slam.model.map_change import MapChange, Redirect, Redirects
from rgbd_slam.model.point_statistics import point_statistics
from rgbd_slam.model.points import PointCounts, PointTable
from rgbd_slam.model.soa_table import DEAD, Column


class Atlas:
    """Keyframes and points of all maps; a new map (`map_id`) starts after a loss."""

    def __init__(self, scale_factor: float, num_octaves: int) -> None:
        self.keyframes = KeyframeTable()
        self.points = PointTable()
        self.version = 1
        self.octave_scale = np.power(scale_factor, np.arange(num_octaves, dtype=np.float64))
        self.redirects = Redirects()

    def clear(self) -> None:
        """Take everything out; what hangs on a keyframe hangs on nothing then."""
        keyframes, points = self.keyframes, self.points
        keyframes.covisibility[:] = 0
        keyframes.release(keyframes.indices(), self.version)
        points.release(points.indices(), self.version)
        self.redirects.clear()

    # ---- keyframes

    def add_keyframe(
        self, frame: Frame, T_map_camera: FloatArray, map_id: int, parent: int | None = None
    ) -> int:
        """Store a keyframe that observes nothing yet and return its index."""
        kf = self.keyframes
        i = int(kf.allocate(1, self.version)[0])
        kf.store_features(i, frame)
        kf.T_map_camera[i] = T_map_camera
        kf.map_id[i] = map_id
        kf.is_loaded[i] = False
        kf.parent_uid[i] = DEAD if parent is None else kf.uid[parent]
        kf.covisibility[i] = kf.covisibility[:, i] = 0
        return i

    def set_poses(self, i: IntArray, T_map_camera: FloatArray) -> None:
        """Move keyframes: (N,) indices, (N, 4, 4) poses."""
        self.keyframes.T_map_camera[i] = T_map_camera
        self.keyframes.version[i] = self.version

    def set_parent(self, i: int, parent: int) -> None:
        """Hang a keyframe on another in the spanning tree."""
        self.keyframes.parent_uid[i] = self.keyframes.uid[parent]
        self.keyframes.version[i] = self.version

    def set_map_id(self, i: IntArray, j: IntArray, map_id: int) -> None:
        """Make keyframes (N,) and points (M,) part of a map."""
        self.keyframes.map_id[i] = self.points.map_id[j] = map_id
        self.keyframes.version[i] = self.points.version[j] = self.version

    def remove_keyframe(self, i: int) -> None:
        """Take a keyframe out; its children, and the frames relative to it, pass to its parent.

        The first keyframe of a map has no parent and must stay.
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
        touched = np.flatnonzero(kf.covisibility[i])
        kf.covisibility[i] = kf.covisibility[:, i] = 0
        kf.version[np.concatenate([children, touched])] = self.version
        kf.release(np.array([i]), self.version)

    def update_connections(self, i: int) -> None:
        """Count anew how many points keyframe `i` shares with every other one."""
        kf = self.keyframes
        seen = kf.point_of_feature[i]
        rows = kf.indices()
        counts = np.count_nonzero(
            self._mask(seen[seen != NO_POINT]).take(kf.point_of_feature[rows]), axis=1
        )
        kf.covisibility[i] = 0
        kf.covisibility[i, rows] = counts
        kf.covisibility[i, i] = 0
        kf.covisibility[:, i] = kf.covisibility[i]
        kf.version[i] = self.version

    def covisible(self, i: int, min_shared: int = 1, limit: int | None = None) -> IntArray:
        """Return keyframes that share at least `min_shared` points with `i`, most first."""
        weight = self.keyframes.covisibility[i]
        rows = np.flatnonzero(weight >= min_shared)
        return rows[np.argsort(-weight[rows], kind='stable')][:limit]

    # ---- points and observations

    def add_points(self, i: int, k: IntArray, position_m: FloatArray) -> IntArray:
        """Make points (N,) at (N, 3) that keyframe `i` observes in its features `k`."""
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
        """Move points: (N,) indices, (N, 3) positions."""
        self.points.position_m[j] = position_m
        self.points.version[j] = self.version

    def observe(self, i: int, k: IntArray, j: IntArray) -> None:
        """Record that keyframe `i` sees points `j` in features `k`, both free before."""
        kf, points = self.keyframes, self.points
        kf.point_of_feature[i, k] = j
        points.num_observations[j] += 1
        points.num_stereo[j] += kf.depth_m[i, k] > 0
        points.version[j] = kf.version[i] = self.version

    def unobserve(self, i: int, k: IntArray) -> None:
        """Forget what features `k` of `i` observe; a point nothing observes is removed."""
        kf, points = self.keyframes, self.points
        k = k[kf.point_of_feature[i, k] != NO_POINT]
        j = kf.point_of_feature[i, k]
        points.num_observations[j] -= 1
        points.num_stereo[j] -= kf.depth_m[i, k] > 0
        kf.point_of_feature[i, k] = NO_POINT
        points.version[j] = kf.version[i] = self.version
        points.release(j[points.num_observations[j] == 0], self.version)

    def forbid_seeds(self, i: int, k: IntArray) -> None:
        """Let no point be made of features `k` of `i` from now on."""
        self.keyframes.may_seed[i, k] = False
        self.keyframes.version[i] = self.version

    def observations_of(self, j: IntArray, keyframes: IntArray | None = None) -> Observations:
        """Return who sees points `j`, of the given keyframes or all, in order of i and k."""
        kf = self.keyframes
        rows = kf.indices() if keyframes is None else keyframes
        seen = kf.point_of_feature[rows]
        n = np.flatnonzero(self._mask(j).take(seen))  # in a third of the time that two axes take
        at, k = np.divmod(n, seen.shape[1])
        return Observations(rows[at], k, seen.take(n).astype(np.int64))

    def remove_points(self, j: IntArray) -> None:
        """Take points out, with all their observations."""
        seen = self.observations_of(j)
        self.keyframes.point_of_feature[seen.i, seen.k] = NO_POINT
        self.keyframes.version[np.unique(seen.i)] = self.version
        self.points.release(j, self.version)

    def replace_points(self, old: IntArray, new: IntArray) -> None:
        """Fuse points: what observes `old[n]` observes `new[n]` from now on, but not twice.

        `old` and `new` are disjoint, and `old` has no repetition.
        """
        if len(old) == 0:
            return
        kf, points = self.keyframes, self.points
        target = np.full(points.capacity, NO_POINT, np.int64)
        target[old] = new
        seen = self.observations_of(old)
        to = target[seen.j]
        have = self.observations_of(np.unique(new))
        key_have = have.i * points.capacity + have.j
        key = seen.i * points.capacity + to
        _, first = np.unique(key, return_index=True)
        moves = np.zeros(len(key), np.bool_)
        moves[first] = True
        moves &= ~np.isin(key, key_have)
        kf.point_of_feature[seen.i, seen.k] = np.where(moves, to, NO_POINT)
        np.add.at(points.num_observations, to[moves], 1)
        np.add.at(points.num_stereo, to[moves], kf.depth_m[seen.i[moves], seen.k[moves]] > 0)
        np.add.at(points.num_visible, new, points.num_visible[old])
        np.add.at(points.num_found, new, points.num_found[old])
        kf.version[np.unique(seen.i)] = self.version
        points.version[new] = self.version
        points.release(old, self.version)

    def refresh(self, j: IntArray) -> None:
        """Derive the viewing direction, scale range and descriptor of live points `j` anew."""
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
        """Add how often frames should have seen points, and did; those gone since are left out."""
        points = self.points
        same = points.uid[counts.points] == counts.uids
        j = counts.points[same]
        points.num_visible[j] += counts.visible[same]
        points.num_found[j] += counts.found[same]
        points.version[j] = self.version

    def _mask(self, j: IntArray) -> BoolArray:
        """Return (capacity + 1,) flags of points; NO_POINT = -1 indexes the last, always False."""
        flags = np.zeros(self.points.capacity + 1, np.bool_)
        flags[j] = True
        flags[-1] = False
        return flags

    # ---- saved maps

    def make_younger(self, by: int) -> None:
        """Raise the ids of all maps, so that older ones can be laid beside them."""
        keyframes, points = self.keyframes, self.points
        i, j = keyframes.indices(), points.indices()
        keyframes.map_id[i] += by
        points.map_id[j] += by
        keyframes.version[i] = points.version[j] = self.version

    def append_keyframes(self, saved: SavedKeyframes) -> IntArray:
        """Store keyframes of an earlier session and return their (N,) rows."""
        kf = self.keyframes
        i = kf.append(saved.columns, self.version)
        kf.is_loaded[i] = True
        kf.parent_uid[i] = np.where(saved.parent == DEAD, DEAD, kf.uid[i[saved.parent]])
        kf.covisibility[i] = kf.covisibility[:, i] = 0
        kf.covisibility[np.ix_(i, i)] = saved.covisibility
        kf.point_of_feature[i] = NO_POINT
        kf.append_features(
            i[saved.keyframe], saved.feature, saved.features, saved.columns['num_features']
        )
        return i

    def append_points(self, columns: Mapping[str, Column], reference: IntArray) -> IntArray:
        """Store points, (N, ...) columns, made by keyframes (N,), and return their rows."""
        points, kf = self.points, self.keyframes
        j = points.append(columns, self.version)
        points.reference_keyframe_uid[j] = points.first_keyframe_uid[j] = kf.uid[reference]
        points.map_id[j] = kf.map_id[reference]
        return j

    def append_observations(self, seen: Observations) -> None:
        """Record who sees the points stored last, whose columns count these observations."""
        self.keyframes.point_of_feature[seen.i, seen.k] = seen.j
        self.refresh(np.unique(seen.j))

    # ---- copies in other processes

    def changes_since(self, version: int) -> MapChange:
        """Return the rows changed after `version`, and open a new version for what follows."""
        change = MapChange(
            self.version,
            self.keyframes.rows_since(version),
            self.points.rows_since(version),
            self.redirects.take(),
        )
        self.version += 1
        return change

    def whole(self) -> MapChange:
        """Return what makes an empty map equal to this one."""
        everything = self.keyframes.rows_since(0), self.points.rows_since(0)
        return MapChange(self.version, *everything, ())

    def apply(self, change: MapChange) -> None:
        """Bring this copy up to date; its own redirects become those of the change."""
        self.keyframes.put_rows(change.keyframes)
        self.points.put_rows(change.points)
        self.version = change.version
        self.redirects.add(change.redirects)
