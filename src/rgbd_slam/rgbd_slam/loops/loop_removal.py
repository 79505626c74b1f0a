"""Removes a wrong loop or merge from a map, and undoes its effects.

The loop has distorted the map and fused points of two places. These points are split again. The
relative poses of connected keyframes are distorted too, and are therefore measured again from the
points that both observe. The remaining loops then determine the map.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.loops.essential_graph import Region, closed_poses, move_map
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.loop_edge import JOIN, LoopEdge
from rgbd_slam.optimize.pose_optimizer import PoseProblem, optimize_pose

# Keyframes that are further apart in order of insertion belong to two visits of a place, as in
# loop_detection.py.
_VISIT = 10
# Chosen: least number of points with depth from which a relative pose is measured.
_MIN_COMMON = 20
_FAR = 2**40  # more than any number of keyframes


class _Parts(NamedTuple):
    """The keyframes of a map in two parts: before and after a loop, or the two merged maps."""

    rows: IntArray  # (K,) of the map, in order of insertion
    rank: IntArray  # (capacity,) position of each keyframe in this order
    # (capacity,) True: keyframes inserted after the loop, or those of the merged map.
    is_later: BoolArray
    # The loop has fused a point that keyframes of both parts observe if the ranks of these
    # keyframes differ by at least this number; 0 for a merge, which has fused all such points.
    min_gap: int
    root: int | None  # row of the first keyframe of the merged map; None for a loop


def remove_loop(atlas: Atlas, camera: StereoCamera, number: int, min_shared: int) -> None:
    """Remove a loop or merge from a map; merged maps become separate again.

    Args:
        number: Number of the loop in `atlas.loops`.
        min_shared: Number of shared points from which two keyframes are connected by an edge.
    """
    edge = atlas.loops[number]
    atlas.loops = (*atlas.loops[:number], *atlas.loops[number + 1 :])
    parts = _parts(atlas, edge)
    if parts is None:
        return
    _split_points(atlas, parts)
    _separate_tree(atlas, parts)
    for i in parts.rows.tolist():
        atlas.update_connections(i)
    if parts.root is not None:
        merged = parts.rows[parts.is_later[parts.rows]]
        new_id = 1 + int(atlas.keyframes.map_id[atlas.keyframes.alive].max())
        atlas.move(merged, np.tile(np.eye(4), (len(merged), 1, 1)), new_id)
    else:
        region = Region(np.sort(parts.rows), np.empty(0, np.int64))
        measure = partial(_measured_pose, atlas, camera)
        poses = closed_poses(atlas, region, atlas.loops, min_shared, measure)
        move_map(atlas, region.rows, poses)


def _parts(atlas: Atlas, edge: LoopEdge) -> _Parts | None:
    """Return the two parts that a loop has connected; None if one of its ends was removed."""
    keyframes = atlas.keyframes
    ends = keyframes.ends_of(edge)
    if ends is None:
        return None
    a, b = ends
    rows = keyframes.indices_by_uid()
    rows = rows[keyframes.map_id[rows] == keyframes.map_id[a]]
    rank, is_later = np.zeros(keyframes.capacity, np.int64), np.zeros(keyframes.capacity, np.bool_)
    rank[rows] = np.arange(len(rows))
    parents = atlas.parents()
    root = b if parents[b] == a else a if parents[a] == b else None
    if edge.kind == JOIN and root is not None:
        is_later[_subtree(atlas, root)] = True
        return _Parts(rows, rank, is_later, 0, root)
    is_later[rows] = 2 * rank[rows] > rank[a] + rank[b]
    return _Parts(rows, rank, is_later, _VISIT, None)


def _subtree(atlas: Atlas, i: int) -> list[int]:
    """Return the rows of a keyframe and of its descendants in the spanning tree."""
    rows = [i]
    for n in rows:  # the list grows in the loop
        rows += atlas.keyframes.children(n).tolist()
    return rows


def _split_points(atlas: Atlas, parts: _Parts) -> None:
    """Create new points for the later part, whose keyframes observe them, not fused ones."""
    points, is_later = atlas.points, parts.is_later
    seen = atlas.observations_of(atlas.points_of(parts.rows))
    later, rank = is_later[seen.i], parts.rank[seen.i]
    first_later, last_before = np.full(points.capacity, _FAR), np.full(points.capacity, -_FAR)
    np.minimum.at(first_later, seen.j[later], rank[later])
    np.maximum.at(last_before, seen.j[~later], rank[~later])
    is_fused = (first_later < _FAR) & (last_before > -_FAR)
    is_fused &= first_later - last_before >= parts.min_gap
    chosen = later & is_fused[seen.j]
    i, k, j = seen.i[chosen], seen.k[chosen], seen.j[chosen]
    position_m, new_point = points.position_m[j].copy(), np.full(points.capacity, NO_POINT)
    for n in np.unique(i).tolist():
        atlas.unobserve(n, k[i == n])
    for n in np.unique(i).tolist():
        at = np.flatnonzero(i == n)
        has_new = new_point[j[at]] != NO_POINT
        known, unknown = at[has_new], at[~has_new]
        atlas.observe(n, k[known], new_point[j[known]])
        new_point[j[unknown]] = atlas.add_points(n, k[unknown], position_m[unknown])
    atlas.refresh(new_point[np.unique(j)])


def _separate_tree(atlas: Atlas, parts: _Parts) -> None:
    """Give each later keyframe whose parent is in the earlier part a parent in the later part."""
    parents = atlas.parents()
    if parts.root is not None:
        atlas.set_parent(parts.root, None)
        return
    for i in parts.rows[parts.is_later[parts.rows]].tolist():
        parent, before = int(parents[i]), int(parts.rows[parts.rank[i] - 1])
        is_crossing = parent >= 0 and not parts.is_later[parent]
        is_far = parts.rank[i] - parts.rank[parent] >= parts.min_gap
        if is_crossing and is_far and before not in _subtree(atlas, i):
            atlas.set_parent(i, before)


def _measured_pose(
    atlas: Atlas, camera: StereoCamera, a: int, b: int, T_a_b: FloatArray
) -> FloatArray:
    """Return T_a_b (4, 4) of two keyframes, measured by points with depth that both observe."""
    keyframes = atlas.keyframes
    points_a, points_b = keyframes.points_of(a), keyframes.points_of(b)
    _, k_a, k_b = np.intersect1d(points_a, points_b, return_indices=True)
    keep = (points_a[k_a] != NO_POINT) & (keyframes.depth_m[a, k_a] > 0)
    k_a, k_b = k_a[keep], k_b[keep]
    if len(k_a) < _MIN_COMMON:
        return T_a_b
    points_m = camera.back_project(keyframes.measurement_px[a, k_a, :2], keyframes.depth_m[a, k_a])
    problem = PoseProblem.of(keyframes.frame(b), k_b, points_m, atlas.octave_scale)
    estimate = optimize_pose(camera, problem, se3.inverse(T_a_b))
    if np.count_nonzero(estimate.inliers) < _MIN_COMMON:
        return T_a_b
    return se3.inverse(se3.orthonormalized(estimate.T_camera_map))
