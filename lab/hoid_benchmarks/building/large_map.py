"""Scenario `loop`: what a loop costs in maps of different sizes, and how long files take.

A map of 100 keyframes is driven and then tiled to the wanted sizes. A loop over 90 % of the map
is closed in it, and the correction is sent to a copy, as to the tracker.
"""

from __future__ import annotations

import pickle
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import psutil

from hoid_benchmarks.building.growth import SIZES, driven_map
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tiled_map import tiled_to
from hoid_benchmarks.building.world.floors import Building
from hoid_common import se3
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.essential_graph import closed_poses, move_map, region_around
from rgbd_slam.loops.global_adjustment import apply_solution, global_problem, solve
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import restore
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile

T = TypeVar('T')

_DRIFT_M = 0.3  # error of the loop that is closed
_SPAN = 0.9  # share of the keyframes that lie between the two ends of the loop
_COLUMNS = {
    'keyframes': 'd',
    'pose correction ms': '.0f',
    'sent MB': '.2f',
    'gap ms': '.0f',
    'adjusted keyframes': 'd',
    'adjustment s': '.1f',
    'adjustment sent MB': '.2f',
    'adjustment gap ms': '.0f',
    'save s': '.1f',
    'file MB': '.0f',
    'load s': '.1f',
    'map MB': '.0f',
}


def large_maps(seed: int, sizes: Sequence[int] = SIZES) -> Outcome:
    """Return the CPU times of a loop, the bytes sent for it, and the times of files."""
    _, _, base = driven_map(Building(seed=seed), seed)
    rows = [_measured(tiled_to(base, size, seed)) for size in sizes]
    return Outcome('loop', 'A loop in a large map (CPU time, one core)', _COLUMNS, rows)


def _measured(content: MapFile) -> dict[str, Any]:
    config = SlamConfig()
    camera = StereoCamera.from_model(content.camera, config.camera)
    row: dict[str, Any] = {'keyframes': len(content.map)}
    atlas, copy = (Atlas(content.scale_factor, content.num_octaves) for _ in range(2))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'large.hoidmap'
        size, row['save s'] = _timed(lambda: map_file.save(path, content))
        row['file MB'] = size / 1e6
        del content
        content, read_s = _timed(lambda: map_file.load(path))
    before = psutil.Process().memory_info().rss
    _, restore_s = _timed(lambda: restore(atlas, content.map, camera, keep=False))
    row['map MB'] = (psutil.Process().memory_info().rss - before) / 1e6
    row['load s'] = read_s + restore_s
    whole = atlas.changes_since(0)
    copy.apply(whole)
    return row | _loop(atlas, copy, whole.version, camera, config)


def _loop(
    atlas: Atlas, copy: Atlas, version: int, camera: StereoCamera, config: SlamConfig
) -> dict[str, Any]:
    """Close a loop and adjust the map around it."""
    keyframes = atlas.keyframes
    rows = keyframes.indices_by_uid()
    ends = rows[[int((1 - _SPAN) * (len(rows) - 1)), -1]]
    first, last = ends.tolist()
    T_first_last = se3.inverse(keyframes.T_map_camera[first]) @ keyframes.T_map_camera[last]
    T_first_last[0, 3] += _DRIFT_M
    covariance = np.diag(np.square([0.001] * 3 + [0.002] * 3))
    uids = int(keyframes.uid[first]), int(keyframes.uid[last])
    shared = config.places.loops.essential_shared

    def correct() -> None:
        region = region_around(atlas, ends, len(keyframes))
        loop = LoopEdge(
            *uids, T_first_last, covariance, 100, 1.0, 'closed', residual_m=0.0, is_used=True
        )
        move_map(atlas, region.rows, closed_poses(atlas, region, [loop], shared))

    _, correction_s = _timed(correct)
    sent_mb, gap_s, version = _sent(atlas, copy, version)
    problem = global_problem(atlas, ends)
    iterations = config.places.loops.global_iterations
    solution, adjustment_s = _timed(lambda: solve(camera, problem.bundle, iterations))
    apply_solution(atlas, problem, solution)
    adjustment_mb, adjustment_gap_s, _ = _sent(atlas, copy, version)
    return {
        'pose correction ms': 1e3 * correction_s,
        'sent MB': sent_mb,
        'gap ms': 1e3 * gap_s,
        'adjusted keyframes': problem.bundle.num_free,
        'adjustment s': adjustment_s,
        'adjustment sent MB': adjustment_mb,
        'adjustment gap ms': 1e3 * adjustment_gap_s,
    }


def _sent(atlas: Atlas, copy: Atlas, version: int) -> tuple[float, float, int]:
    """Send the changes to a copy; return the MB, the time to apply them [s], and the version."""
    change = atlas.changes_since(version)
    size = len(pickle.dumps(change, pickle.HIGHEST_PROTOCOL))
    _, gap_s = _timed(lambda: copy.apply(change))
    return size / 1e6, gap_s, change.version


def _timed(function: Callable[[], T]) -> tuple[T, float]:
    """Return what a function returns, and its CPU time [s]."""
    start_s = time.process_time()
    value = function()
    return value, time.process_time() - start_s
