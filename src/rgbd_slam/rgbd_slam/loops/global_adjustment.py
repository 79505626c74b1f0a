"""Global bundle adjustment in the background, while mapping continues.

It works on a copy of a large part of the map. Loops may be closed meanwhile: their corrections are
first applied to the solution, and then the solution to the map. Keyframes that were created
meanwhile move with their parent in the spanning tree.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.process.child_process import ChildEndedError, ChildTimeoutError, ChildWorker
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.loops.essential_graph import move_map, region_around
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.map_change import Move
from rgbd_slam.optimize.bundle_adjustment import (
    BundleProblem,
    BundleSolution,
    adjust,
    bundle_problem,
)
from rgbd_slam.optimize.measured_noise import with_residual_noise
from rgbd_slam.records.soa_table import SoaTable

_NICE = 10  # chosen: tracking and mapping have priority on few cores (decision 016)
_ALL = slice(None)
# Chosen: largest number of keyframes around a loop that are adjusted; the others keep their poses
# from the pose graph. `solve`, with its three solutions, takes 3.4 s of CPU time for 999 keyframes
# (docs/results/building.md).
_MAX_KEYFRAMES = 1000

_Work = tuple[StereoCamera, BundleProblem, int]  # the arguments of `solve`

_logger = logging.getLogger(__name__)


class GlobalProblem(NamedTuple):
    """The bundle adjustment problem of a part of a map, and the uids of keyframes and points."""

    bundle: BundleProblem
    keyframe_uids: IntArray  # (C,)
    point_uids: IntArray  # (P,)
    point_owners: IntArray  # (P,) uid of the keyframe with which each point moves
    next_uid: int  # keyframes from this uid on are newer than the problem


def global_problem(atlas: Atlas, around: IntArray) -> GlobalProblem:
    """Return the problem of up to 1,000 keyframes around the rows `around` (K,) of one map.

    The border of this region and the first keyframe of the map are fixed. The points are observed
    in the region, and at least twice in the problem.
    """
    keyframes, points = atlas.keyframes, atlas.points
    region = region_around(atlas, around, _MAX_KEYFRAMES)
    is_root = atlas.parents()[region.rows] < 0
    cameras = np.r_[region.rows[~is_root], region.rows[is_root], region.border]
    inside = atlas.points_of(region.rows)
    seen = atlas.observations_of(inside, cameras).j
    j, counts = np.unique(seen, return_counts=True)
    j = j[counts > 1]
    bundle, _ = bundle_problem(atlas, cameras, int(np.count_nonzero(~is_root)), j)
    return GlobalProblem(
        bundle,
        keyframes.uid[cameras],
        points.uid[j],
        points.reference_keyframe_uid[j],
        1 + int(keyframes.uid.max()),
    )


def solve(camera: StereoCamera, bundle: BundleProblem, iterations: int) -> BundleSolution:
    """Solve a problem three times, with up to `iterations` iterations each.

    The first solution uses the configured noise of the camera, the second one the noise that the
    residuals show. Some outliers are found only with this noise and have distorted both solutions;
    the third one leaves them out.
    """
    first = adjust(camera, bundle, iterations)
    camera, bundle = with_residual_noise(camera, bundle, first)
    second = adjust(camera, _continued(bundle, first), iterations)
    return adjust(camera, _continued(bundle, second, ~second.outliers), iterations)


def _continued(
    bundle: BundleProblem, solution: BundleSolution, kept: BoolArray | slice = _ALL
) -> BundleProblem:
    """Return the problem with the solution as initial values and only the kept observations."""
    return replace(
        bundle,
        T_camera_map=solution.T_camera_map,
        points_m=solution.points_m,
        camera=bundle.camera[kept],
        point=bundle.point[kept],
        measured_px=np.ascontiguousarray(bundle.measured_px[:, kept]),
        inv_sigma2=bundle.inv_sigma2[kept],
    )


def apply_solution(
    atlas: Atlas, problem: GlobalProblem, solution: BundleSolution, moves: Iterable[Move] = ()
) -> Move:
    """Apply a solution to a map that was corrected by `moves` meanwhile; return the motions."""
    keyframes, points = atlas.keyframes, atlas.points
    solved = se3.inverse(solution.T_camera_map)
    solved_m = np.ascontiguousarray(solution.points_m.T)
    for move in moves:
        solved, solved_m = _moved(problem, solved, solved_m, move)
    rows, n = _still_in_map(keyframes, problem.keyframe_uids[: problem.bundle.num_free])
    before = keyframes.T_map_camera.copy()
    after = keyframes.T_map_camera.copy()
    after[rows] = solved[n]
    new = _descendants(atlas, rows, problem.next_uid)
    for i, parent in new:
        after[i] = after[parent] @ se3.inverse(before[parent]) @ before[i]
    moved = np.r_[rows, np.array([i for i, _ in new], np.int64)]
    move = move_map(atlas, moved, after[moved])
    j, n = _still_in_map(points, problem.point_uids)
    # Points are not refreshed, because viewing directions and distances hardly change, and
    # descriptors not at all.
    atlas.set_positions(j, solved_m[n])
    return move


def _moved(
    problem: GlobalProblem, T_map_camera: FloatArray, points_m: FloatArray, move: Move
) -> tuple[FloatArray, FloatArray]:
    """Return a solution's poses (C, 4, 4) and points (P, 3), corrected by a move of the map."""
    order = np.argsort(move.uids)

    def motions(uids: IntArray) -> FloatArray:
        at = np.minimum(np.searchsorted(move.uids, uids, sorter=order), len(order) - 1)
        is_known = move.uids[order[at]] == uids
        return np.where(is_known[:, None, None], move.T_new_old[order[at]], np.eye(4))

    T = motions(problem.point_owners)
    moved_m = np.einsum('nij,nj->ni', T[:, :3, :3], points_m) + T[:, :3, 3]
    return motions(problem.keyframe_uids) @ T_map_camera, moved_m


def _still_in_map(table: SoaTable, uids: IntArray) -> tuple[IntArray, IntArray]:
    """Return the rows of elements that a table still has, and their positions in `uids`."""
    rows = table.rows_of(uids)
    known = np.flatnonzero(rows >= 0)
    return rows[known], known


def _descendants(atlas: Atlas, rows: IntArray, first_uid: int) -> list[tuple[int, int]]:
    """Return (child, parent) rows of descendants of `rows` with a uid from `first_uid` on."""
    found: list[tuple[int, int]] = []
    known = set(rows.tolist())
    queue = rows.tolist()
    while queue:
        parent = queue.pop(0)
        for child in atlas.keyframes.children(parent).tolist():
            if child not in known and atlas.keyframes.uid[child] >= first_uid:
                known.add(child)
                found.append((child, parent))
                queue.append(child)
    return found


def _run_solver(work: Connection, solutions: Connection) -> None:
    """Receive one problem and send its solution; this is the main function of the process."""
    os.nice(_NICE)
    with suppress(EOFError, OSError):  # the mapper has ended, or has stopped this adjustment
        solutions.send(solve(*work.recv()))


class _Running(NamedTuple):
    """An adjustment that runs in a separate process."""

    problem: GlobalProblem
    worker: ChildWorker[_Work, BundleSolution]
    moves: list[Move]  # corrections of the map since the adjustment was started


class GlobalAdjuster:
    """Adjusts large parts of a map, one after the other.

    Args:
        background: Whether an adjustment runs in a separate process, and `poll` applies its
            solution; otherwise `start` applies it.
    """

    def __init__(
        self, atlas: Atlas, camera: StereoCamera, iterations: int, *, background: bool
    ) -> None:
        self._atlas = atlas
        self._camera = camera
        self._iterations = iterations
        self._background = background
        self._running: _Running | None = None
        # Keyframes around which the next adjustment is requested.
        self._next_uids: IntArray = np.empty(0, np.int64)

    @property
    def is_running(self) -> bool:
        return self._running is not None

    def start(self, around: IntArray) -> None:
        """Adjust the map around keyframes (rows), now or when the running adjustment has ended."""
        if self._running is not None:
            self._next_uids = self._atlas.keyframes.uid[around]
            return
        problem = global_problem(self._atlas, around)
        if problem.bundle.num_free == 0:
            return
        if self._background:
            worker = ChildWorker[_Work, BundleSolution]('global adjustment', _run_solver)
            self._running = _Running(problem, worker, [])
            worker.send((self._camera, problem.bundle, self._iterations))
        else:
            solution = solve(self._camera, problem.bundle, self._iterations)
            apply_solution(self._atlas, problem, solution)

    def rebase(self, move: Move) -> None:
        """Store a correction of the map, which a running adjustment must take into account."""
        if self._running is not None:
            self._running.moves.append(move)

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Wait up to `timeout_s` for a running adjustment; return whether it was applied."""
        running = self._running
        if running is None:
            return False
        solution: BundleSolution | None = None
        try:
            solution = running.worker.receive(timeout_s)
        except ChildTimeoutError:
            return False
        except ChildEndedError:
            _logger.warning(
                'global bundle adjustment has failed; the map keeps its closed loops without it'
            )
        self._stop()
        if solution is not None:
            apply_solution(self._atlas, running.problem, solution, running.moves)
        rows, _ = _still_in_map(self._atlas.keyframes, self._next_uids)
        self._next_uids = self._next_uids[:0]
        if len(rows):
            self.start(rows)
        return solution is not None

    def close(self) -> None:
        """Stop a running adjustment without applying it, and drop a requested one."""
        self._next_uids = self._next_uids[:0]
        self._stop()

    def _stop(self) -> None:
        if self._running is not None:
            self._running.worker.close(patience_s=0.0)
            self._running = None
