"""Takes back a loop or join that is wrong, with what has followed from it.

The loop has bent the map and has fused points of two places. The fused points are split again, and
the relative poses of neighbors are measured anew from the points that they share, since the
present ones are bent. The remaining loops then determine the map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.loops.essential_graph import connected_pairs, constraints, move_map
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.loop_edge import JOIN, LoopEdge
from rgbd_slam.optimize.pose_optimizer import PoseProblem, optimize_pose

# As in loop_detection.py: keyframes that are further apart in order of insertion belong to two
# visits of a place.
_VISIT = 10
_MIN_COMMON = 20  # chosen: points with depth from which a relative pose is measured
_FAR = 2**40  # more than any number of keyframes


class _Sides(NamedTuple):
    """The keyframes of a map before and after a loop, or of the two maps of a join."""

    rows: IntArray  # (K,) of the map, in order of insertion
    rank: IntArray  # (capacity,) position of each in this order
    is_new: BoolArray  # (capacity,) True: after the loop, or in the map that was added
    # Least distance in the order between observations of a point on both sides that follow from
    # the loop; 0 for a join, where all do.
    min_gap: int
    root: int | None  # of the map that a join has added; None for a loop


def open_loop(atlas: Atlas, camera: StereoCamera, number: int, min_shared: int) -> None:
    """Remove a loop or join from a map; the two maps of a join become separate again.

    Args:
        atlas: The map.
        camera: The camera with its configured noise.
        number: Number of the loop in `atlas.loops`.
        min_shared: Number of shared points from which two keyframes are connected by an edge.
    """
    edge = atlas.loops[number]
    atlas.loops = (*atlas.loops[:number], *atlas.loops[number + 1 :])
    sides = _sides(atlas, edge)
    if sides is None:
        return
    _split_points(atlas, sides)
    _separate_tree(atlas, sides)
    for i in sides.rows.tolist():
        atlas.update_connections(i)
    if sides.root is not None:
        added = sides.rows[sides.is_new[sides.rows]]
        new_id = 1 + int(atlas.keyframes.map_id[atlas.keyframes.alive].max())
        atlas.move(added, np.tile(np.eye(4), (len(added), 1, 1)), new_id)
    else:
        move_map(atlas, sides.rows, _unbent_poses(atlas, camera, sides.rows, min_shared))


def _sides(atlas: Atlas, edge: LoopEdge) -> _Sides | None:
    """Return the two sides of a loop; None if a keyframe at its ends is gone."""
    keyframes = atlas.keyframes
    ends = keyframes.ends_of(edge)
    if ends is None:
        return None
    a, b = ends
    rows = keyframes.indices_by_uid()
    rows = rows[keyframes.map_id[rows] == keyframes.map_id[a]]
    rank, is_new = np.zeros(keyframes.capacity, np.int64), np.zeros(keyframes.capacity, np.bool_)
    rank[rows] = np.arange(len(rows))
    parents = atlas.parents()
    root = b if parents[b] == a else a if parents[a] == b else None
    if edge.kind == JOIN and root is not None:
        is_new[_subtree(atlas, root)] = True
        return _Sides(rows, rank, is_new, 0, root)
    is_new[rows] = 2 * rank[rows] > rank[a] + rank[b]
    return _Sides(rows, rank, is_new, _VISIT, None)


def _subtree(atlas: Atlas, i: int) -> list[int]:
    """Return the rows of a keyframe and of its descendants in the spanning tree."""
    rows = [i]
    for n in rows:  # grows meanwhile
        rows += atlas.keyframes.children(n).tolist()
    return rows


def _split_points(atlas: Atlas, sides: _Sides) -> None:
    """Let the keyframes of the new side observe points of their own instead of fused ones."""
    points, is_new = atlas.points, sides.is_new
    seen = atlas.observations_of(atlas.points_of(sides.rows))
    new, rank = is_new[seen.i], sides.rank[seen.i]
    first_new, last_old = np.full(points.capacity, _FAR), np.full(points.capacity, -_FAR)
    np.minimum.at(first_new, seen.j[new], rank[new])
    np.maximum.at(last_old, seen.j[~new], rank[~new])
    is_fused = (first_new < _FAR) & (last_old > -_FAR) & (first_new - last_old >= sides.min_gap)
    chosen = new & is_fused[seen.j]
    i, k, j = seen.i[chosen], seen.k[chosen], seen.j[chosen]
    position_m, own = points.position_m[j].copy(), np.full(points.capacity, NO_POINT)
    for n in np.unique(i).tolist():
        atlas.unobserve(n, k[i == n])
    for n in np.unique(i).tolist():
        at = np.flatnonzero(i == n)
        known, fresh = at[own[j[at]] != NO_POINT], at[own[j[at]] == NO_POINT]
        atlas.observe(n, k[known], own[j[known]])
        own[j[fresh]] = atlas.add_points(n, k[fresh], position_m[fresh])
    atlas.refresh(own[np.unique(j)])


def _separate_tree(atlas: Atlas, sides: _Sides) -> None:
    """Give keyframes of the new side a parent before them, where the loop gave them another.

    The map that a join has added gets its root back.
    """
    parents = atlas.parents()
    if sides.root is not None:
        atlas.set_parent(sides.root, None)
        return
    for i in sides.rows[sides.is_new[sides.rows]].tolist():
        parent, before = int(parents[i]), int(sides.rows[sides.rank[i] - 1])
        is_crossing = parent >= 0 and not sides.is_new[parent]
        is_far = sides.rank[i] - sides.rank[parent] >= sides.min_gap
        if is_crossing and is_far and before not in _subtree(atlas, i):
            atlas.set_parent(i, before)


def _unbent_poses(
    atlas: Atlas, camera: StereoCamera, rows: IntArray, min_shared: int
) -> FloatArray:
    """Return the poses T_map_camera (K, 4, 4) by measured relative poses and the loops."""
    # Imported here, because GTSAM would delay the restart of a killed node (decision 030).
    from rgbd_slam.optimize.gtsam_pose_graph import PoseGraph  # noqa: PLC0415

    keyframes, parents, graph = atlas.keyframes, atlas.parents(), PoseGraph()
    for i in rows.tolist():
        graph.add_keyframe(i, keyframes.T_map_camera[i], fixed=bool(parents[i] < 0))
    pairs = connected_pairs(atlas, rows, min_shared)
    for a, b, T_a_b, *sigmas in constraints(pairs, keyframes.T_map_camera):
        graph.add_constraint(a, b, _measured_motion(atlas, camera, a, b, T_a_b), *sigmas)
    for edge in atlas.loops:
        ends = keyframes.ends_of(edge)
        if ends is not None and edge.is_used and ends[0] in rows:
            graph.add_measurement(*ends, edge.T_first_second, edge.covariance)
    return graph.optimize()


def _measured_motion(
    atlas: Atlas, camera: StereoCamera, a: int, b: int, T_a_b: FloatArray
) -> FloatArray:
    """Return T_a_b (4, 4) of two keyframes, measured from the points that both observe.

    The present `T_a_b` is returned if they share too few points with depth.
    """
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
