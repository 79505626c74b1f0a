"""The essential graph of ORB-SLAM: the pose graph of keyframes that distributes a loop's error.

Its edges are the spanning tree, pairs of keyframes that share many points, and the loops closed so
far (Mur-Artal et al., T-RO 2015, sec. VII). Scale is not estimated, because depth measures it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from hoid_native.results import Edges
from rgbd_slam.loops.keyframe_groups import keyframe_groups, spread_corrections
from rgbd_slam.loops.region import Region
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_change import Move
from rgbd_slam.model.map_tables import NEAR_SHARED
from rgbd_slam.places.geometric_verification import PlaceMatch

# Not tuned: standard deviations of the translation of an edge (a constant [m], plus a share of its
# length) and of its rotation [rad], as good visual odometry has. Long edges and edges with few
# shared points absorb most of a correction. How far a loop is closed depends on their size in
# comparison with the covariance of the loop (`link_covariance`).
_SIGMA_M = 0.005
_SIGMA_SHARE = 0.01
_SIGMA_RAD = 0.002
_STRONG_SHARED = 100  # Mur-Artal et al., T-RO 2015: shared points of a strong edge (theta)
# Not tuned: factor on the standard deviations of the pose at a recognized place, and the standard
# deviations of the errors that are added to them.
_LINK_FACTOR = 3.0
_LINK_SIGMA_M = 0.002
_LINK_SIGMA_RAD = 0.001
_DRIFT_M_PER_RAD = 0.3  # not tuned: a rotation by 1 rad causes as much drift as a path of 0.3 m


def link_covariance(match: PlaceMatch) -> FloatArray:
    """Return the (6, 6) covariance of a loop in the frame of the matched camera, rotation first.

    Units are rad^2 and m^2. It is larger than the covariance of the match, which holds for
    independent errors only: the points of the place share errors of the map.
    """
    constant = np.square([_LINK_SIGMA_RAD] * 3 + [_LINK_SIGMA_M] * 3)
    return np.asarray(_LINK_FACTOR**2 * match.covariance + np.diag(constant))


def path_length_m(atlas: Atlas, start: int, goal: int) -> float:
    """Return the length [m] of the shortest path from keyframe to keyframe between two of them.

    A path leads along keyframes that share at least 15 points, or are parent and child in the
    spanning tree; rotations along it add 0.3 m per rad (Dijkstra's algorithm). The drift between
    the two grows with this length and not with time, because no drift is added in known places.
    The length is infinite between different maps.

    Args:
        atlas: The map.
        start: Row of one keyframe.
        goal: Row of the other keyframe.
    """
    return atlas.path_length_m(start, goal, NEAR_SHARED, _DRIFT_M_PER_RAD)


def closed_poses(
    atlas: Atlas, region: Region, loops: Sequence[LoopEdge], min_shared: int
) -> FloatArray:
    """Return the poses T_map_camera (N, 4, 4) of a region's keyframes after closing loops.

    They are in the order of `region.rows`; the map itself is not changed. The keyframes at the
    border of the region and the first keyframe of the map keep their poses. The pose graph has
    two kinds of edges: the present relative poses of connected keyframes, and the relative poses
    that were measured for the loops.

    Args:
        atlas: The map.
        region: The keyframes whose poses are corrected.
        loops: All closed loops; a loop has no effect if it is not used, if one of its keyframes is
            neither in the region nor at its border, or if both are in the same group
            (`keyframe_groups`).
        min_shared: Number of shared points from which two keyframes are connected by an edge.
    """
    # Imported here, because GTSAM would delay the restart of a killed node (decision 030).
    from rgbd_slam.optimize.gtsam_pose_graph import PoseGraph  # noqa: PLC0415

    keyframes = atlas.keyframes
    rows = np.r_[region.rows, region.border]
    position = np.full(keyframes.capacity, -1, np.int64)
    position[rows] = np.arange(len(rows))
    parents = atlas.parents()[rows]
    groups = keyframe_groups(np.where(parents >= 0, position[parents], -1))
    poses = keyframes.T_map_camera[rows]
    T_map_head = poses[groups.heads]
    group_of = np.where(position >= 0, groups.group[position], -1)  # of each keyframe of the map
    pairs = _between_groups(connected_pairs(atlas, rows, min_shared), group_of)
    graph = PoseGraph()
    is_fixed = (parents[groups.heads] < 0) | (groups.heads >= len(region.rows))
    for g, T in enumerate(T_map_head):
        graph.add_keyframe(g, T, fixed=bool(is_fixed[g]))
    for edge in constraints(pairs, T_map_head):
        graph.add_constraint(*edge)
    for link in _links(atlas, loops, group_of, T_map_head):
        graph.add_measurement(*link)
    corrected = spread_corrections(groups, poses, graph.optimize(), pairs.first, pairs.second)
    return corrected[: len(region.rows)]


def constraints(
    pairs: Edges, T_map_head: FloatArray
) -> Iterator[tuple[int, int, FloatArray, float, float]]:
    """Yield (a, b, T_a_b, sigma_rad, sigma_m) for each connected pair of groups a and b.

    T_a_b (4, 4) is the present relative pose of their heads, and the sigmas are the standard
    deviations of its rotation and of its translation.
    """
    T_a_b = se3.inverse(T_map_head[pairs.first]) @ T_map_head[pairs.second]
    weak = np.sqrt(_STRONG_SHARED / np.clip(pairs.shared, NEAR_SHARED, _STRONG_SHARED))
    sigma_m = weak * (_SIGMA_M + _SIGMA_SHARE * np.linalg.norm(T_a_b[:, :3, 3], axis=1))
    sigma_rad = _SIGMA_RAD * weak
    for n, (a, b) in enumerate(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)):
        yield a, b, T_a_b[n], float(sigma_rad[n]), float(sigma_m[n])


def _links(
    atlas: Atlas, loops: Sequence[LoopEdge], group_of: IntArray, T_map_head: FloatArray
) -> Iterator[tuple[int, int, FloatArray, FloatArray]]:
    """Yield (g, h, T_g_h, covariance) for each loop between two groups g and h.

    T_g_h (4, 4) is the relative pose of their heads by the loop, and its covariance (6, 6) is in
    the frame of the head of h, rotation first. A loop within a group, or with a keyframe outside
    of the graph, is left out.
    """
    keyframes = atlas.keyframes
    for loop in loops:
        ends = keyframes.ends_of(loop)
        if ends is None or not loop.is_used:
            continue
        a, b = ends
        g, h = int(group_of[a]), int(group_of[b])
        if min(g, h) < 0 or g == h:
            continue
        T_head_a = se3.inverse(T_map_head[g]) @ keyframes.T_map_camera[a]
        T_b_head = se3.inverse(keyframes.T_map_camera[b]) @ T_map_head[h]
        to_head = se3.adjoint(se3.inverse(T_b_head))
        covariance = to_head @ loop.covariance @ to_head.T
        yield g, h, T_head_a @ loop.T_first_second @ T_b_head, covariance


def _between_groups(edges: Edges, group_of: IntArray) -> Edges:
    """Return the pairs of different groups that edges connect, with group numbers as the ends.

    The first group has the lower number. `shared` is that of the strongest edge between the two.

    Args:
        edges: Edges between keyframes, possibly several for the same pair of groups.
        group_of: (capacity,) group of each keyframe; -1 for those outside of the graph.
    """
    ends = group_of[np.stack([edges.first, edges.second])]
    low, high = ends.min(0), ends.max(0)
    between = np.flatnonzero((low != high) & (low >= 0))
    order = between[np.lexsort((-edges.shared[between], high[between], low[between]))]
    is_new = np.r_[
        True, (low[order][1:] != low[order][:-1]) | (high[order][1:] != high[order][:-1])
    ][: len(order)]
    chosen = order[is_new]
    return Edges(low[chosen], high[chosen], edges.shared[chosen])


def connected_pairs(atlas: Atlas, rows: IntArray, min_shared: int) -> Edges:
    """Return the pairs of keyframes that are parent and child, or share `min_shared` points.

    The first keyframe of a pair has the lower row. Of a pair that shares points, the first one is
    in `rows`; of a parent and child, the child is. The other keyframe may be outside. `shared` is
    0 for a parent and child that share no points.
    """
    keyframes = atlas.keyframes
    pairs = atlas.edges()
    key = pairs.first * keyframes.capacity + pairs.second
    parents = atlas.parents()[rows]
    ends = np.stack([rows, parents])[:, parents >= 0]
    tree = ends.min(0) * keyframes.capacity + ends.max(0)
    strong = key[(pairs.shared >= min_shared) & np.isin(pairs.first, rows)]
    chosen = np.union1d(strong, tree)
    at = np.minimum(np.searchsorted(key, chosen), max(len(key) - 1, 0))
    shared = np.where(key[at] == chosen, pairs.shared[at], 0) if len(key) else 0 * chosen
    return Edges(*np.divmod(chosen, keyframes.capacity), shared)


def move_map(atlas: Atlas, rows: IntArray, T_map_camera: FloatArray) -> Move:
    """Move keyframes in rows (N,) to poses T_map_camera (N, 4, 4), and their points with them.

    A point moves with its reference keyframe. Returns the motion of each keyframe.
    """
    return atlas.move(rows, T_map_camera @ se3.inverse(atlas.keyframes.T_map_camera[rows]))
