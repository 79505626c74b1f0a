"""The essential graph of ORB-SLAM: the pose graph of keyframes that distributes a loop's error.

Its edges are the spanning tree, pairs of keyframes that share many points, and the loops closed so
far (Mur-Artal et al., T-RO 2015, sec. VII). Poses have no scale, because depth makes it
observable.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from hoid_native.results import Edges
from rgbd_slam.model.atlas import Atlas

_MIN_SHARED = 15  # ORB-SLAM3, KeyFrame.cc, UpdateConnections: shared points of neighbors
# Not tuned: standard deviations of an edge, those of good visual odometry over its length. Only
# their ratios matter: long edges and edges with few shared points absorb most of the correction.
_SIGMA_M = 0.005
_SIGMA_SHARE = 0.01
_SIGMA_RAD = 0.002
_STRONG_SHARED = 100  # Mur-Artal et al., T-RO 2015: shared points of a strong edge (theta)
_LOOP_SIGMA_M = 0.002
_LOOP_SIGMA_RAD = 0.001
_DRIFT_M_PER_RAD = 0.3  # not tuned: the path length that causes the drift of a rotation by 1 rad


class Loop(NamedTuple):
    """A closed loop: the measured relative pose of two keyframes that show the same place."""

    uid_a: int
    uid_b: int
    T_a_b: FloatArray  # (4, 4)


def path_length_m(atlas: Atlas, start: int, goal: int) -> float:
    """Return the length [m] of the shortest path between two keyframes in the covisibility graph.

    The drift between them grows with it, not with the time between them: in known places no drift
    is added. The length is infinite between different maps (Dijkstra's algorithm).
    """
    length = np.full(atlas.keyframes.capacity, np.inf)
    length[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        so_far, i = heappop(queue)
        if i == goal:
            return so_far
        if so_far > length[i]:
            continue
        near = _neighbors(atlas, i)
        reached = so_far + _distance_m(atlas, i, near)
        shorter = reached < length[near]
        length[near[shorter]] = reached[shorter]
        for distance_m, n in zip(reached[shorter].tolist(), near[shorter].tolist(), strict=True):
            heappush(queue, (distance_m, n))
    return float('inf')


def _neighbors(atlas: Atlas, i: int) -> IntArray:
    """Return the keyframes that share points with keyframe `i` or are next to it in the tree."""
    keyframes = atlas.keyframes
    parent = np.flatnonzero((keyframes.uid == keyframes.parent_uid[i]) & keyframes.alive)
    tree = np.r_[parent, keyframes.children(i)]
    return np.union1d(atlas.covisible(i, _MIN_SHARED), tree)


def _distance_m(atlas: Atlas, i: int, others: IntArray) -> FloatArray:
    """Return the (N,) distances from keyframe `i`; rotations count as the path of equal drift."""
    poses = atlas.keyframes.T_map_camera
    twist = se3.log(se3.inverse(poses[i]) @ poses[others])
    turn_rad = np.linalg.norm(twist[:, :3], axis=1)
    translation_m = np.linalg.norm(twist[:, 3:], axis=1)
    return np.asarray(translation_m + _DRIFT_M_PER_RAD * turn_rad)


def closed_poses(
    atlas: Atlas, map_id: int, loops: list[Loop], min_shared: int
) -> tuple[IntArray, FloatArray]:
    """Return the keyframes of a map (N,), and their poses after closing loops (N, 4, 4).

    The first keyframe is fixed. The edges are the current relative poses; the loops are the
    measured ones.
    """
    # Imported here, because GTSAM would delay the restart of a killed node (decision 030).
    from rgbd_slam.optimize.gtsam_pose_graph import PoseGraph  # noqa: PLC0415

    keyframes = atlas.keyframes
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == map_id))
    graph = PoseGraph()
    for i in rows.tolist():
        is_root = keyframes.index_of(int(keyframes.parent_uid[i])) is None
        graph.add_keyframe(int(keyframes.uid[i]), keyframes.T_map_camera[i], fixed=is_root)
    first, second, shared = _edges(atlas, rows, min_shared)
    T_a_b = se3.inverse(keyframes.T_map_camera[first]) @ keyframes.T_map_camera[second]
    weak = np.sqrt(_STRONG_SHARED / np.clip(shared, _MIN_SHARED, _STRONG_SHARED))
    sigma_m = weak * (_SIGMA_M + _SIGMA_SHARE * np.linalg.norm(T_a_b[:, :3, 3], axis=1))
    uid_a, uid_b = keyframes.uid[first].tolist(), keyframes.uid[second].tolist()
    sigma_rad = _SIGMA_RAD * weak
    for edge in zip(uid_a, uid_b, T_a_b, sigma_rad.tolist(), sigma_m.tolist(), strict=True):
        graph.add_constraint(*edge)
    present = set(keyframes.uid[rows].tolist())
    for loop in loops:
        if {loop.uid_a, loop.uid_b} <= present:
            graph.add_constraint(*loop, _LOOP_SIGMA_RAD, _LOOP_SIGMA_M)
    return rows, graph.optimize()


def _edges(atlas: Atlas, rows: IntArray, min_shared: int) -> Edges:
    """Return the pairs of `rows` that are next to each other in the tree or share many points."""
    keyframes = atlas.keyframes
    pairs = atlas.edges()
    key = pairs.first * keyframes.capacity + pairs.second
    order = np.argsort(keyframes.uid[rows])
    uids = keyframes.uid[rows][order]
    position = np.minimum(np.searchsorted(uids, keyframes.parent_uid[rows]), len(rows) - 1)
    has_parent = uids[position] == keyframes.parent_uid[rows]
    ends = np.stack([rows[has_parent], rows[order[position[has_parent]]]])
    tree = ends.min(0) * keyframes.capacity + ends.max(0)
    strong = key[(pairs.shared >= min_shared) & np.isin(pairs.first, rows)]
    chosen = np.union1d(strong, tree)
    at = np.minimum(np.searchsorted(key, chosen), max(len(key) - 1, 0))
    shared = np.where(key[at] == chosen, pairs.shared[at], 0) if len(key) else 0 * chosen
    return Edges(*np.divmod(chosen, keyframes.capacity), shared)


def move_map(atlas: Atlas, rows: IntArray, T_map_camera: FloatArray) -> None:
    """Move keyframes (N,) to new poses (N, 4, 4), and their points with them."""
    keyframes, points = atlas.keyframes, atlas.points
    motion = np.tile(np.eye(4), (keyframes.capacity, 1, 1))
    motion[rows] = T_map_camera @ se3.inverse(keyframes.T_map_camera[rows])
    owner = _owners(atlas, rows)
    j = np.flatnonzero(owner >= 0)
    T = motion[owner[j]]
    moved = (T[:, :3, :3] @ points.position_m[j, :, None])[..., 0] + T[:, :3, 3]
    atlas.set_poses(rows, T_map_camera)
    atlas.set_positions(j, moved)
    atlas.refresh(j)


def _owners(atlas: Atlas, rows: IntArray) -> IntArray:
    """Return the (capacity,) keyframe among `rows` that each point moves with, or -1.

    It is the reference keyframe of the point, otherwise any that observes it.
    """
    keyframes, points = atlas.keyframes, atlas.points
    seen = atlas.observations_of(points.indices(), rows)
    owner = np.full(points.capacity, -1, np.int64)
    owner[seen.j] = seen.i
    is_reference = keyframes.uid[seen.i] == points.reference_keyframe_uid[seen.j]
    owner[seen.j[is_reference]] = seen.i[is_reference]
    return owner
