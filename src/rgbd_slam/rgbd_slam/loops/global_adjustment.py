"""Bundle adjustment of a whole map in the background, while mapping continues.

The problem is a copy of the map. Its solution is applied to the map of a later time: keyframes
that were created meanwhile move with their parent in the spanning tree.
"""

from __future__ import annotations

import logging
import os
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

_NICE = 10  # chosen: tracking and mapping have priority on few cores (decision 016)
_ALL = slice(None)
# Chosen: the largest map that is adjusted. The time of the dense solver grows with the cube of the
# number of keyframes, its memory with the square: 28 s and 0.3 GB for 1000 keyframes. A larger map
# keeps the poses of the pose graph.
_MAX_KEYFRAMES = 1000

_logger = logging.getLogger(__name__)


class GlobalProblem(NamedTuple):
    """The bundle adjustment problem of a map, and the uids of its keyframes and points."""

    bundle: BundleProblem
    keyframe_uids: IntArray  # (C,)
    point_uids: IntArray  # (P,)


def global_problem(atlas: Atlas, map_id: int) -> GlobalProblem:
    """Return the problem of a map, whose first keyframe is fixed."""
    keyframes, points = atlas.keyframes, atlas.points
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == map_id))
    is_root = ~np.isin(keyframes.parent_uid[rows], keyframes.uid[rows])
    cameras = np.r_[rows[~is_root], rows[is_root]]
    seen = atlas.observations_of(points.indices(), cameras).j
    j = np.flatnonzero(np.bincount(seen, minlength=points.capacity) > 1)
    bundle, _ = bundle_problem(atlas, cameras, int(np.count_nonzero(~is_root)), j)
    return GlobalProblem(bundle, keyframes.uid[cameras], points.uid[j])


def solve(camera: StereoCamera, bundle: BundleProblem, iterations: int) -> BundleSolution:
    """Return the solution by the configured noise, then by the noise that its residuals show.

    The measured noise reveals outliers that the configured one did not, and which have distorted
    the solution; therefore the map is adjusted once more without them.

    With 309 keyframes, 18,000 points and 157,000 observations, it takes 4.7 s.
    """
    first = adjust(camera, bundle, iterations)
    camera, bundle = with_residual_noise(camera, bundle, first)
    second = adjust(camera, _continued(bundle, first), iterations)
    return adjust(camera, _continued(bundle, second, ~second.outliers), iterations)


def _continued(
    bundle: BundleProblem, solution: BundleSolution, kept: BoolArray | slice = _ALL
) -> BundleProblem:
    """Return a problem that starts at a solution, with the kept observations only."""
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
    """Apply a solution to the current map; newer keyframes move with their parents."""
    keyframes, points = atlas.keyframes, atlas.points
    rows, n = _still_in_map(keyframes, problem.keyframe_uids)
    before = keyframes.T_map_camera.copy()
    after = keyframes.T_map_camera.copy()
    after[rows] = se3.inverse(solution.T_camera_map[n])
    new = _descendants(atlas, rows)
    for i, parent in new:
        after[i] = after[parent] @ se3.inverse(before[parent]) @ before[i]
    moved = np.r_[rows, np.array([i for i, _ in new], np.int64)]
    move_map(atlas, moved, after[moved])
    j, n = _still_in_map(points, problem.point_uids)
    atlas.set_positions(j, solution.points_m.T[n])
    atlas.refresh(j)


def _still_in_map(table: SoaTable, uids: IntArray) -> tuple[IntArray, IntArray]:
    """Return the rows of the elements that still exist, and their positions in `uids`."""
    rows = table.indices()
    _, in_table, in_uids = np.intersect1d(table.uid[rows], uids, return_indices=True)
    return rows[in_table], in_uids


def _descendants(atlas: Atlas, rows: IntArray) -> list[tuple[int, int]]:
    """Return the descendants of `rows` in the spanning tree with their parents, parents first."""
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


def _run_solver(work: Connection, solutions: Connection) -> None:
    """Receive one problem and send its solution; the main function of the process."""
    os.nice(_NICE)
    with suppress(EOFError, OSError):  # the mapper has ended or has stopped this adjustment
        solutions.send(solve(*work.recv()))


class _Running(NamedTuple):
    """An adjustment in a separate process, so that the mapper goes on."""

    problem: GlobalProblem
    worker: ChildWorker[tuple[StereoCamera, BundleProblem, int], BundleSolution]

    def take(self, timeout_s: float) -> BundleSolution | None:
        """Return the solution, or None if the process has failed.

        Raises:
            ChildTimeoutError: The solution has not arrived in time.
        """
        try:
            return self.worker.receive(timeout_s)
        except ChildEndedError:
            _logger.warning(
                'global bundle adjustment has failed; the map keeps its closed loops without it'
            )
            return None

    def close(self) -> None:
        """End the process at once and discard its solution."""
        self.worker.close(patience_s=0.0)


class GlobalAdjuster:
    """Adjusts whole maps, at once or in the background."""

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
        """Return whether an adjustment is running in the background."""
        return self._running is not None

    def start(self, map_id: int) -> None:
        """Start to adjust a map; a running adjustment is outdated and is stopped."""
        self.close()
        problem = global_problem(self._atlas, map_id)
        num_keyframes = len(problem.keyframe_uids)
        if num_keyframes > _MAX_KEYFRAMES:
            _logger.info('the map has %d keyframes and is not adjusted as a whole', num_keyframes)
            return
        if problem.bundle.num_free == 0:
            return
        if self._background:
            self._running = _Running(problem, ChildWorker('global adjustment', _run_solver))
            self._running.worker.send((self._camera, problem.bundle, self._iterations))
        else:
            solution = solve(self._camera, problem.bundle, self._iterations)
            apply_solution(self._atlas, problem, solution)

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Apply an adjustment that finishes in time to the map; return whether there was one."""
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
        """Stop the adjustment in the background."""
        if self._running is not None:
            self._running.close()
            self._running = None
