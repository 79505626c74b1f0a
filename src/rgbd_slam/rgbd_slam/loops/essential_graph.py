"""The essential graph of ORB-SLAM: a pose graph of keyframes that distributes a loop's error.

Its edges are the spanning tree, pairs of keyframes that share many points, and all closed loops
(Mur-Artal et al., T-RO 2015, sec. VII). Scale is not estimated, because depth measures it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from hoid_native.results import Edges
from rgbd_slam.loops.keyframe_groups import keyframe_groups, spread_corrections
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_change import Move
from rgbd_slam.model.map_tables import NEAR_SHARED
from rgbd_slam.places.geometric_verification import PlaceMatch

# Not tuned: standard deviations of an edge's translation (a constant in m, plus a ratio of its
# length) and rotation (rad), typical of good visual odometry. Long edges and edges with few shared
# points absorb most of a correction. How far a loop is closed depends on the ratio of these values
# to the covariance of the loop (`loop_covariance`).
_SIGMA_M = 0.005
_SIGMA_SHARE = 0.01
_SIGMA_RAD = 0.002
_STRONG_SHARED = 100  # Mur-Artal et al., T-RO 2015: shared points of a strong edge (theta)
# Not tuned: factor on the standard deviations of a loop match, and standard deviations of further
# errors that are added.
_LOOP_FACTOR = 3.0
_LOOP_SIGMA_M = 0.002
_LOOP_SIGMA_RAD = 0.001
_DRIFT_M_PER_RAD = 0.3  # not tuned: a rotation by 1 rad adds as much drift as a path of 0.3 m
# Chosen: largest deviation of the optimized map from a loop, in rad and m. Loops between the same
# places deviate by some centimeters; places that look alike are at least 2 m apart.
_MAX_DEVIATION = np.deg2rad(5.0), 0.25  # [rad], [m]

_logger = logging.getLogger(__name__)


class Region(NamedTuple):
    """Connected keyframes of one map."""

    rows: IntArray  # (N,) ascending
    # (M,) ascending rows of keyframes outside that are connected with one inside; their poses are
    # fixed.
    border: IntArray


def region_around(atlas: Atlas, starts: IntArray, limit: int) -> Region:
    """Return up to `limit` keyframes around the rows `starts` (K,), by breadth-first search.

    Connected keyframes share at least 15 points, or are parent and child in the spanning tree.
    """
    parents = atlas.parents()
    order = np.argsort(parents, kind='stable')
    first = np.searchsorted(parents[order], np.arange(len(parents) + 1))
    known, chosen, border = set(starts.tolist()), list[int](), list[int]()
    waiting = starts.tolist()
    for i in waiting:  # the list grows in the loop
        if len(chosen) == limit:
            border.append(i)
            continue
        chosen.append(i)
        near = [
            *atlas.covisible(i, NEAR_SHARED).tolist(),
            *order[first[i] : first[i + 1]].tolist(),
        ]
        if parents[i] >= 0:
            near.append(int(parents[i]))
        new = [n for n in near if n not in known]
        known.update(new)
        waiting += dict.fromkeys(new)
    return Region(np.sort(np.array(chosen, np.int64)), np.sort(np.array(border, np.int64)))


def loop_covariance(match: PlaceMatch) -> FloatArray:
    """Return the covariance (6, 6) of a loop (rad^2, m^2) in the frame of the new camera.

    It is larger than the match's covariance, because the matched points share errors of the map.
    """
    constant = np.square([_LOOP_SIGMA_RAD] * 3 + [_LOOP_SIGMA_M] * 3)
    return np.asarray(_LOOP_FACTOR**2 * match.covariance + np.diag(constant))


def path_length_m(atlas: Atlas, start: int, goal: int) -> float:
    """Return the length [m] of the shortest path between two keyframes (rows) in the map.

    The path follows connected keyframes (`region_around`); rotations add 0.3 m per rad. The drift
    between two keyframes grows with this length and not with time, because known places add no
    drift. The length is infinite between different maps.
    """
    return atlas.path_length_m(start, goal, NEAR_SHARED, _DRIFT_M_PER_RAD)


def motion_size(T: FloatArray) -> tuple[float, float]:
    """Return the rotation angle [rad] and the translation [m] of a motion (4, 4)."""
    return float(np.linalg.norm(se3.log(T)[:3])), float(np.linalg.norm(T[:3, 3]))


def optimized(
    atlas: Atlas, region: Region, min_shared: int
) -> tuple[FloatArray, tuple[LoopEdge, ...]]:
    """Return the optimized poses of a map, without the loops that contradict the rest.

    As in RTAB-Map (RGBD/OptimizeMaxError), a loop is left out if the optimized poses deviate from
    it by more than 0.25 m or 5 degrees, because then this loop or another one is wrong. The one
    with the largest deviation is left out first, of several the newest.

    Returns:
        The poses T_map_camera (N, 4, 4) of the region's keyframes (see `closed_poses`), and all
        loops with their residuals, in which `is_used` is False for those that are left out.
    """
    loops = list(atlas.loops)
    while True:
        T_map_camera = closed_poses(atlas, region, loops, min_shared)
        poses = atlas.keyframes.T_map_camera.copy()
        poses[region.rows] = T_map_camera
        deviations = np.array([_deviation(atlas, edge, poses) for edge in loops])
        loops = [
            e._replace(residual_m=m) for e, m in zip(loops, deviations[:, 1].tolist(), strict=True)
        ]
        excess = (deviations / _MAX_DEVIATION).max(1) * [edge.is_used for edge in loops]
        worst = int(len(excess) - 1 - np.argmax(excess[::-1]))
        if excess[worst] <= 1.0:
            return T_map_camera, tuple(loops)
        text = 'loop %d is left out: the rest of the map contradicts it by %.2f m'
        _logger.warning(text, worst, loops[worst].residual_m)
        loops[worst] = loops[worst]._replace(is_used=False)


def _deviation(atlas: Atlas, edge: LoopEdge, poses: FloatArray) -> tuple[float, float]:
    """Return the rotation (rad) and distance (m) by which poses (capacity, 4, 4) miss a loop."""
    ends = atlas.keyframes.ends_of(edge)
    return (0.0, 0.0) if ends is None else motion_size(edge.residual(*poses[list(ends)]))


def closed_poses(
    atlas: Atlas,
    region: Region,
    loops: Sequence[LoopEdge],
    min_shared: int,
    measure: Callable[[int, int, FloatArray], FloatArray] | None = None,
) -> FloatArray:
    """Return the poses T_map_camera (N, 4, 4) of a region's keyframes by pose graph optimization.

    They are in the order of `region.rows`. The keyframes at the border of the region and the first
    keyframe of the map keep their poses.

    Args:
        region: The keyframes whose poses are corrected.
        loops: Loops that are not in use, or have an end outside the graph, have no effect.
        min_shared: Number of shared points from which two keyframes are connected by an edge.
        measure: Returns the relative pose T_a_b (4, 4) of two connected keyframes, given their
            rows and their present relative pose, which is used if None. Large maps are then
            optimized in groups (`keyframe_groups`).
    """
    # Imported here, because importing GTSAM would delay the restart of a killed node (decision
    # 030).
    from rgbd_slam.optimize.gtsam_pose_graph import PoseGraph  # noqa: PLC0415

    keyframes = atlas.keyframes
    rows = np.r_[region.rows, region.border]
    position = np.full(keyframes.capacity, -1, np.int64)
    position[rows] = np.arange(len(rows))
    parents = atlas.parents()[rows]
    groups = keyframe_groups(
        np.where(parents >= 0, position[parents], -1), is_grouped=measure is None
    )
    poses = keyframes.T_map_camera[rows]
    T_map_head = poses[groups.heads]
    # Group of each keyframe of the map.
    group_of = np.where(position >= 0, groups.group[position], -1)
    pairs = _between_groups(connected_pairs(atlas, rows, min_shared), group_of)
    graph = PoseGraph()
    is_fixed = (parents[groups.heads] < 0) | (groups.heads >= len(region.rows))
    for g, T in enumerate(T_map_head):
        graph.add_keyframe(g, T, fixed=bool(is_fixed[g]))
    heads = rows[groups.heads].tolist()
    for g, h, T_g_h, *sigmas in _relative_poses(pairs, T_map_head):
        T = T_g_h if measure is None else measure(heads[g], heads[h], T_g_h)
        graph.add_constraint(g, h, T, *sigmas)
    for loop in _loops_between_groups(atlas, loops, group_of, T_map_head):
        graph.add_measurement(*loop)
    corrected = spread_corrections(groups, poses, graph.optimize(), pairs.first, pairs.second)
    return corrected[: len(region.rows)]


def _relative_poses(
    pairs: Edges, T_map_head: FloatArray
) -> Iterator[tuple[int, int, FloatArray, float, float]]:
    """Yield (g, h, T_g_h, sigma_rad, sigma_m) of connected groups g, h at their present poses."""
    T_g_h = se3.inverse(T_map_head[pairs.first]) @ T_map_head[pairs.second]
    weak = np.sqrt(_STRONG_SHARED / np.clip(pairs.shared, NEAR_SHARED, _STRONG_SHARED))
    sigma_m = weak * (_SIGMA_M + _SIGMA_SHARE * np.linalg.norm(T_g_h[:, :3, 3], axis=1))
    sigma_rad = _SIGMA_RAD * weak
    for n, (g, h) in enumerate(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)):
        yield g, h, T_g_h[n], float(sigma_rad[n]), float(sigma_m[n])


def _loops_between_groups(
    atlas: Atlas, loops: Sequence[LoopEdge], group_of: IntArray, T_map_head: FloatArray
) -> Iterator[tuple[int, int, FloatArray, FloatArray]]:
    """Yield (g, h, T_g_h, covariance) for each used loop between two groups g and h.

    T_g_h (4, 4) is the relative pose of the heads; the covariance (6, 6) is in the frame of h's
    head, rotation first.
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
    """Return pairs of groups that edges of keyframes connect, each with its strongest edge."""
    ends = group_of[np.stack([edges.first, edges.second])]
    low, high = ends.min(0), ends.max(0)
    between = np.flatnonzero((low != high) & (low >= 0))
    order = between[np.lexsort((-edges.shared[between], high[between], low[between]))]
    _, strongest = np.unique(low[order] * len(group_of) + high[order], return_index=True)
    chosen = order[strongest]
    return Edges(low[chosen], high[chosen], edges.shared[chosen])


def connected_pairs(atlas: Atlas, rows: IntArray, min_shared: int) -> Edges:
    """Return the edges of spanning tree and covisibility that begin at keyframes in `rows`."""
    keyframes = atlas.keyframes
    pairs = atlas.graph.edges()
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
    """Move keyframes (N,) to poses T_map_camera (N, 4, 4), together with their points."""
    return atlas.move(rows, T_map_camera @ se3.inverse(atlas.keyframes.T_map_camera[rows]))
