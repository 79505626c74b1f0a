"""The atlas: keyframes and points of all maps, and the operations that keep them consistent.

An `Atlas` has one writer. Offline this is the mapper in the same process. Live the mapper has its
own atlas in a separate process and sends `MapChange`s (the rows that changed since the last one),
which the tracker applies to its copy between two frames. An observation is a triple `(i, k, j)`:
keyframe i observes point j in its feature k.
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
    """Keyframes and points of all maps; after a loss, a new map (`map_id`) may be started."""

    def __init__(self, scale_factor: float, num_octaves: int) -> None:
        self.keyframes = KeyframeTable()
        self.points = PointTable()
        self.version = 1
        self.octave_scale = np.power(scale_factor, np.arange(num_octaves, dtype=np.float64))
        self.redirects = Redirects()

    def clear(self) -> None:
        """Remove all keyframes and points; poses relative to them become undefined."""
        keyframes, points = self.keyframes, self.points
        keyframes.covisibility[:] = 0
        keyframes.release(keyframes.indices(), self.version)
        points.release(points.indices(), self.version)
        self.redirects.clear()

    # ---- keyframes

    def add_keyframe(
        self, frame: Frame, T_map_camera: FloatArray, map_id: int, parent: int | None = None
    ) -> int:
        """Store a keyframe without observations and return its row."""
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
        """Set the poses (N, 4, 4) of keyframes (N,)."""
        self.keyframes.T_map_camera[i] = T_map_camera
        self.keyframes.version[i] = self.version

    def set_parent(self, i: int, parent: int) -> None:
        """Set the parent of a keyframe in the spanning tree."""
        self.keyframes.parent_uid[i] = self.keyframes.uid[parent]
        self.keyframes.version[i] = self.version

    def set_map_id(self, i: IntArray, j: IntArray, map_id: int) -> None:
        """Assign keyframes (N,) and points (M,) to a map."""
        self.keyframes.map_id[i] = self.points.map_id[j] = map_id
        self.keyframes.version[i] = self.points.version[j] = self.version

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
        touched = np.flatnonzero(kf.covisibility[i])
        kf.covisibility[i] = kf.covisibility[:, i] = 0
        kf.version[np.concatenate([children, touched])] = self.version
        kf.release(np.array([i]), self.version)

    def update_connections(self, i: int) -> None:
        """Recount the points that keyframe `i` shares with every other keyframe."""
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
        """Return (N,) keyframes that share at least `min_shared` points with `i`, most first."""
        weight = self.keyframes.covisibility[i]
        rows = np.flatnonzero(weight >= min_shared)
        return rows[np.argsort(-weight[rows], kind='stable')][:limit]

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
        self.points.version[j] = self.version

    def observe(self, i: int, k: IntArray, j: IntArray) -> None:
        """Add the observations of points `j` in features `k` of keyframe `i`, both free before."""
        kf, points = self.keyframes, self.points
        kf.point_of_feature[i, k] = j
        points.num_observations[j] += 1
        points.num_stereo[j] += kf.depth_m[i, k] > 0
        points.version[j] = kf.version[i] = self.version

    def unobserve(self, i: int, k: IntArray) -> None:
        """Remove the observations of features `k` of `i`, and points that have none left."""
        kf, points = self.keyframes, self.points
        k = k[kf.point_of_feature[i, k] != NO_POINT]
        j = kf.point_of_feature[i, k]
        points.num_observations[j] -= 1
        points.num_stereo[j] -= kf.depth_m[i, k] > 0
        kf.point_of_feature[i, k] = NO_POINT
        points.version[j] = kf.version[i] = self.version
        points.release(j[points.num_observations[j] == 0], self.version)

    def forbid_seeds(self, i: int, k: IntArray) -> None:
        """Forbid that features `k` of `i` create points from now on."""
        self.keyframes.may_seed[i, k] = False
        self.keyframes.version[i] = self.version

    def observations_of(self, j: IntArray, keyframes: IntArray | None = None) -> Observations:
        """Return the observations of points `j` by `keyframes` (or all), sorted by i and k."""
        kf = self.keyframes
        rows = kf.indices() if keyframes is None else keyframes
        seen = kf.point_of_feature[rows]
        n = np.flatnonzero(self._mask(j).take(seen))  # three times as fast as on two axes
        at, k = np.divmod(n, seen.shape[1])
        return Observations(rows[at], k, seen.take(n).astype(np.int64))

    def remove_points(self, j: IntArray) -> None:
        """Remove points with all their observations."""
        seen = self.observations_of(j)
        self.keyframes.point_of_feature[seen.i, seen.k] = NO_POINT
        self.keyframes.version[np.unique(seen.i)] = self.version
        self.points.release(j, self.version)

    def replace_points(self, old: IntArray, new: IntArray) -> None:
        """Fuse points: observations of `old[n]` become observations of `new[n]`.

        A keyframe that observes both keeps its observation of `new[n]` alone. `old` and `new` are
        disjoint, and `old` has no repetitions.
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

    def _mask(self, j: IntArray) -> BoolArray:
        """Return (capacity + 1,) flags of points; NO_POINT = -1 indexes the last, always False."""
        flags = np.zeros(self.points.capacity + 1, np.bool_)
        flags[j] = True
        flags[-1] = False
        return flags

    # ---- saved maps

    def make_younger(self, by: int) -> None:
        """Increase the ids of all maps, so that older maps can be added with lower ids."""
        keyframes, points = self.keyframes, self.points
        i, j = keyframes.indices(), points.indices()
        keyframes.map_id[i] += by
        points.map_id[j] += by
        keyframes.version[i] = points.version[j] = self.version

    def append_keyframes(self, saved: SavedKeyframes) -> IntArray:
        """Add keyframes of an earlier session and return their (N,) rows."""
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
        self.keyframes.point_of_feature[seen.i, seen.k] = seen.j
        self.refresh(np.unique(seen.j))

    # ---- copies in other processes

    def changes_since(self, version: int) -> MapChange:
        """Return the rows changed after `version`, and start a new version for later changes."""
        change = MapChange(
            self.version,
            self.keyframes.rows_since(version),
            self.points.rows_since(version),
            self.redirects.take(),
        )
        self.version += 1
        return change

    def whole(self) -> MapChange:
        """Return the change that makes an empty atlas equal to this one."""
        everything = self.keyframes.rows_since(0), self.points.rows_since(0)
        return MapChange(self.version, *everything, ())

    def apply(self, change: MapChange) -> None:
        """Apply a change to this copy, and add the redirects of the change to its own."""
        self.keyframes.put_rows(change.keyframes)
        self.points.put_rows(change.points)
        self.version = change.version
        self.redirects.add(change.redirects)
