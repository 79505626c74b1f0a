"""The map's keyframes as a pose graph: what ties them, and what a loop does to them.

ORB-SLAM's essential graph: the spanning tree, pairs that share many points, and the loops closed
so far (Mur-Artal et al., T-RO 2015, sec. VII), without scale, which depth makes observable.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas

_MIN_SHARED = 15  # points that make two keyframes neighbours
# A link's standard deviation: that of good odometry over its length. Only ratios matter to the
# result: long links and links by few points give way before short and strong ones.
_SIGMA_M = 0.005
_SIGMA_SHARE = 0.01
_SIGMA_RAD = 0.002
_STRONG_SHARED = 100
_LOOP_SIGMA_M = 0.002
_LOOP_SIGMA_RAD = 0.001
_TURN_M_PER_RAD = 0.3  # a turn costs as much drift as this long a way


class Loop(NamedTuple):
    """Two keyframes found to see one place."""

    uid_a: int
    uid_b: int
    T_a_b: FloatArray  # (4, 4)


def path_length_m(atlas: Atlas, start: int, goal: int) -> float:
    """Return the shortest way between two keyframes along shared points or the spanning tree.

    Drift grows with it, and not with the time between the two, which loops inside known
    places do not add drift to. It is infinite between maps.
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
        near = _linked(atlas, i)
        reached = so_far + _way_m(atlas, i, near)
        shorter = reached < length[near]
        length[near[shorter]] = reached[shorter]
        for metres, n in zip(reached[shorter].tolist(), near[shorter].tolist(), strict=True):
            heappush(queue, (metres, n))
    return float('inf')


def _linked(atlas: Atlas, i: int) -> IntArray:
    keyframes = atlas.keyframes
    parent = np.flatnonzero((keyframes.uid == keyframes.parent_uid[i]) & keyframes.alive)
    tree = np.r_[parent, keyframes.children(i)]
    return np.union1d(atlas.covisible(i, _MIN_SHARED), tree)


def _way_m(atlas: Atlas, i: int, others: IntArray) -> FloatArray:
    poses = atlas.keyframes.T_map_camera
    twist = se3.log(se3.inverse(poses[i]) @ poses[others])
    turn_rad = np.linalg.norm(twist[:, :3], axis=1)
    way: FloatArray = np.linalg.norm(twist[:, 3:], axis=1) + _TURN_M_PER_RAD * turn_rad
    return way


def closed_poses(
    atlas: Atlas, map_id: int, loops: list[Loop], min_shared: int
) -> tuple[IntArray, FloatArray]:
    """Return the keyframes of a map, (N,), and where the loops move them, (N, 4, 4).

    The first keyframe holds the frame. Links measure what the poses are now, loops what was seen.
    """
    # Here, as a killed node is not back before all is loaded that its start imports.
    from rgbd_slam.optimize.gtsam_pose_graph import PoseGraph  # noqa: PLC0415

    keyframes = atlas.keyframes
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == map_id))
    graph = PoseGraph()
    for i in rows.tolist():
        is_root = keyframes.index_of(int(keyframes.parent_uid[i])) is None
        graph.add_keyframe(int(keyframes.uid[i]), keyframes.T_map_camera[i], fixed=is_root)
    first, second = _links(atlas, rows, min_shared)
    T_a_b = se3.inverse(keyframes.T_map_camera[first]) @ keyframes.T_map_camera[second]
    shared = keyframes.covisibility[first, second]
    weak = np.sqrt(_STRONG_SHARED / np.clip(shared, _MIN_SHARED, _STRONG_SHARED))
    sigma_m = weak * (_SIGMA_M + _SIGMA_SHARE * np.linalg.norm(T_a_b[:, :3, 3], axis=1))
    uid_a, uid_b = keyframes.uid[first].tolist(), keyframes.uid[second].tolist()
    sigma_rad = _SIGMA_RAD * weak
    for link in zip(uid_a, uid_b, T_a_b, sigma_rad.tolist(), sigma_m.tolist(), strict=True):
        graph.add_constraint(*link)
    present = set(keyframes.uid[rows].tolist())
    for loop in loops:
        if {loop.uid_a, loop.uid_b} <= present:
            graph.add_constraint(*loop, _LOOP_SIGMA_RAD, _LOOP_SIGMA_M)
    return rows, graph.optimize().T_map_camera


def _links(atlas: Atlas, rows: IntArray, min_shared: int) -> tuple[IntArray, IntArray]:
    """Return the pairs (E,), (E,) of rows tied by the tree or by many shared points."""
    keyframes = atlas.keyframes
    tied = keyframes.covisibility[np.ix_(rows, rows)] >= min_shared
    order = np.argsort(keyframes.uid[rows])
    uids = keyframes.uid[rows][order]
    at = np.minimum(np.searchsorted(uids, keyframes.parent_uid[rows]), len(rows) - 1)
    has_parent = uids[at] == keyframes.parent_uid[rows]
    tied[np.flatnonzero(has_parent), order[at[has_parent]]] = True
    a, b = np.nonzero(np.triu(tied | tied.T, 1))
    return rows[a], rows[b]


def move_map(atlas: Atlas, rows: IntArray, T_map_camera: FloatArray) -> None:
    """Give keyframes (N,) new poses (N, 4, 4), and let the points follow."""
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
    """Return (capacity,) the keyframe among `rows` that each point moves with, or -1.

    That is the one whose view set its scale range, or else any that sees it.
    """
    keyframes, points = atlas.keyframes, atlas.points
    seen = atlas.observations_of(points.indices(), rows)
    owner = np.full(points.capacity, -1, np.int64)
    owner[seen.j] = seen.i
    is_reference = keyframes.uid[seen.i] == points.reference_keyframe_uid[seen.j]
    owner[seen.j[is_reference]] = seen.i[is_reference]
    return owner
