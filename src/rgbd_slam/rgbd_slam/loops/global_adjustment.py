"""Bundle adjustment of a whole map, beside the mapping that goes on meanwhile.

The problem is a copy of the map; its solution is laid over the map as it has become: keyframes and
points made meanwhile follow the keyframe they hang on.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.process.child_process import ChildEndedError, ChildTimeoutError, ChildWorker
from hoid_common.values import BoolArray, IntArray
from rgbd_slam.loops.essential_graph import move_map
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.soa_table import SoaTable
from rgbd_slam.optimize.bundle_problem import BundleProblem, BundleSolution, adjust
from rgbd_slam.optimize.local_bundle_adjustment import bundle_problem
from rgbd_slam.optimize.residual_noise import with_residual_noise

_NICE = 10  # below mapping
_ALL = slice(None)
_DENSE_LIMIT = 500  # keyframes: dense time grows with their cube, memory with the square

_logger = logging.getLogger(__name__)


class GlobalProblem(NamedTuple):
    """A map's keyframes and points as a bundle, and what its rows are in the map."""

    bundle: BundleProblem
    keyframe_uids: IntArray  # (C,)
    point_uids: IntArray  # (P,)


def global_problem(atlas: Atlas, map_id: int) -> GlobalProblem:
    """Copy a map; its first keyframe holds the frame."""
    keyframes, points = atlas.keyframes, atlas.points
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == map_id))
    is_root = ~np.isin(keyframes.parent_uid[rows], keyframes.uid[rows])
    cameras = np.r_[rows[~is_root], rows[is_root]]
    seen = atlas.observations_of(points.indices(), cameras).j
    j = np.flatnonzero(np.bincount(seen, minlength=points.capacity) > 1)
    bundle, _ = bundle_problem(atlas, cameras, int(np.count_nonzero(~is_root)), j)
    return GlobalProblem(bundle, keyframes.uid[cameras], points.uid[j])


def solve(camera: StereoCamera, bundle: BundleProblem, iterations: int) -> BundleSolution:
    """Adjust a bundle with the configured noise, then with the one its residuals show.

    The measured noise tells outliers that the configured one hid, and which have bent the map
    meanwhile: it is adjusted once more, free of them.

    At equal accuracy the dense solver takes 4.7 s for 309 keyframes, 18 000 points and 157 000
    observations, and GTSAM 24.7 s.
    """
    solver: Callable[[StereoCamera, BundleProblem, int], BundleSolution] = adjust
    if len(bundle.T_camera_map) > _DENSE_LIMIT:
        # Here, as a killed node is not back before all is loaded that its start imports.
        from rgbd_slam.optimize.gtsam_bundle import solve_bundle_gtsam  # noqa: PLC0415

        solver = solve_bundle_gtsam
    first = solver(camera, bundle, iterations)
    camera, bundle = with_residual_noise(camera, bundle, first)
    second = solver(camera, _continued(bundle, first), iterations)
    return solver(camera, _continued(bundle, second, ~second.outliers), iterations)


def _continued(
    bundle: BundleProblem, solution: BundleSolution, kept: BoolArray | slice = _ALL
) -> BundleProblem:
    """Return a bundle, or those of its observations that are kept, at a solution."""
    return replace(
        bundle,
        T_camera_map=solution.T_camera_map,
        points_m=solution.points_m,
        camera=bundle.camera[kept],
        point=bundle.point[kept],
        measured_px=np.ascontiguousarray(bundle.measured_px[:, kept]),
        inv_sigma2=bundle.inv_sigma2[kept],
    )


def apply_solution(atlas: Atlas, problem: GlobalProblem, solution: BundleSolution) -> None:
    """Move the map to a solution of what it was; what is new follows what it hangs on."""
    keyframes, points = atlas.keyframes, atlas.points
    rows, at = _still_there(keyframes, problem.keyframe_uids)
    before = keyframes.T_map_camera.copy()
    after = keyframes.T_map_camera.copy()
    after[rows] = se3.inverse(solution.T_camera_map[at])
    new = _hanging_on(atlas, rows)
    for i, parent in new:
        after[i] = after[parent] @ se3.inverse(before[parent]) @ before[i]
    moved = np.r_[rows, np.array([i for i, _ in new], np.int64)]
    move_map(atlas, moved, after[moved])
    j, at = _still_there(points, problem.point_uids)
    atlas.set_positions(j, solution.points_m.T[at])
    atlas.refresh(j)


def _still_there(table: SoaTable, uids: IntArray) -> tuple[IntArray, IntArray]:
    """Return the rows that hold the given elements, and where in `uids` each is."""
    rows = table.indices()
    _, in_table, in_uids = np.intersect1d(table.uid[rows], uids, return_indices=True)
    return rows[in_table], in_uids


def _hanging_on(atlas: Atlas, rows: IntArray) -> list[tuple[int, int]]:
    """Return descendants of `rows` in the tree, each with its parent, parents first."""
    found: list[tuple[int, int]] = []
    known = set(rows.tolist())
    queue = rows.tolist()
    while queue:
        parent = queue.pop(0)
        for child in atlas.keyframes.children(parent).tolist():
            if child not in known:
                known.add(child)
                found.append((child, parent))
                queue.append(child)
    return found


def _solve_apart(work: Connection, solutions: Connection) -> None:
    """Solve one bundle; the main function of the process."""
    os.nice(_NICE)
    with suppress(EOFError, OSError):  # the mapper has ended, or wants nothing of it any more
        solutions.send(solve(*work.recv()))


class _Running(NamedTuple):
    """One adjustment in a process of its own, as GTSAM holds the GIL; it takes idle time only."""

    problem: GlobalProblem
    worker: ChildWorker[tuple[StereoCamera, BundleProblem, int], BundleSolution]

    def take(self, timeout_s: float) -> BundleSolution | None:
        """Return the solution; None when the process has failed.

        Raises:
            ChildTimeoutError: It is not there in time.
        """
        try:
            return self.worker.receive(timeout_s)
        except ChildEndedError:
            _logger.warning('the adjustment of the whole map has failed; its loops stay closed')
            return None

    def close(self) -> None:
        """End the process at once: nobody waits for its solution any more."""
        self.worker.close(patience_s=0.0)


class GlobalAdjuster:
    """Adjusts whole maps: at once, or in the background."""

    def __init__(
        self, atlas: Atlas, camera: StereoCamera, iterations: int, *, background: bool
    ) -> None:
        self._atlas = atlas
        self._camera = camera
        self._iterations = iterations
        self._background = background
        self._running: _Running | None = None

    @property
    def is_running(self) -> bool:
        """Return whether an adjustment is under way in the background."""
        return self._running is not None

    def start(self, map_id: int) -> None:
        """Begin to adjust a map; one still under way is outdated and ended."""
        self.close()
        problem = global_problem(self._atlas, map_id)
        if problem.bundle.num_free == 0:
            return
        if self._background:
            self._running = _Running(problem, ChildWorker('global adjustment', _solve_apart))
            self._running.worker.send((self._camera, problem.bundle, self._iterations))
        else:
            solution = solve(self._camera, problem.bundle, self._iterations)
            apply_solution(self._atlas, problem, solution)

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Lay an adjustment that ends in time over the map; return whether there was one."""
        running = self._running
        if running is None:
            return False
        try:
            solution = running.take(timeout_s)
        except ChildTimeoutError:
            return False
        self.close()
        if solution is not None:
            apply_solution(self._atlas, running.problem, solution)
        return solution is not None

    def close(self) -> None:
        """End what runs in the background."""
        if self._running is not None:
            self._running.close()
            self._running = None
