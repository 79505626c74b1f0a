"""The files of a run, written aside and moved into place when all are whole."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from hoid_bags.trajectory_io import write_tum
from hoid_bringup.evaluation import AlignedTrajectory, align
from hoid_bringup.plots import plot_run
from hoid_bringup.summary import RunResult, Summary, summarize
from hoid_common.errors import InputError
from hoid_common.values import FloatArray, Trajectory
from rgbd_slam.dense import export
from rgbd_slam.dense.grid import write_map_server


def write_outputs(out_dir: Path, result: RunResult) -> Summary:
    """Write all files of a run into a folder, made when missing.

    Raises:
        InputError: The folder cannot be written to, or the disk is full; no half file stays.
    """
    summary = summarize(result)
    with staged(out_dir) as stage:
        write_tum(stage / 'trajectory.txt', result.final)
        write_tum(stage / 'trajectory_online.txt', result.online)
        write_tum(stage / 'keyframes.txt', result.keyframes)
        write_ply(stage / 'map.ply', result.map_points_m)
        if result.cloud is not None:
            export.write_ply(stage / 'cloud.ply', result.cloud)
        if result.grid is not None:
            write_map_server(result.grid, stage / 'grid')
        aligned = _aligned_or_none(result.final, result.ground_truth)
        plot_run(stage / 'trajectory.png', result.final, aligned, _title(summary))
        (stage / 'summary.json').write_text(summary.to_json(), encoding='utf-8')
    return summary


@contextmanager
def staged(out_dir: Path) -> Iterator[Path]:
    """Give a temporary folder whose files move into `out_dir` when the block ends well."""
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix='.partial-', dir=out_dir))
    except OSError as error:
        raise InputError(f'{out_dir}: cannot be written to: {error.strerror}') from error
    try:
        yield stage
        for path in sorted(stage.iterdir()):
            path.replace(out_dir / path.name)
    except OSError as error:
        raise InputError(f'{out_dir}: cannot write results: {error.strerror}') from error
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def write_ply(path: Path, points_m: FloatArray) -> None:
    """Write (N, 3) points as a binary little-endian PLY of float32 x, y, z in m."""
    header = (
        f'ply\nformat binary_little_endian 1.0\nelement vertex {len(points_m)}\n'
        'property float x\nproperty float y\nproperty float z\nend_header\n'
    )
    path.write_bytes(header.encode() + np.ascontiguousarray(points_m, '<f4').tobytes())


def _aligned_or_none(estimate: Trajectory, truth: Trajectory | None) -> AlignedTrajectory | None:
    if truth is None:
        return None
    try:
        return align(estimate, truth)
    except InputError:
        return None


def _title(summary: Summary) -> str:
    parts = [summary.input, f'filter {summary.options.get("filter", "none")}']
    if summary.ate_rmse_m is not None:
        parts.append(f'ATE {100 * summary.ate_rmse_m:.2f} cm')
    parts.append(f'{summary.frames_tracked} of {summary.frames_total} frames tracked')
    return '  ·  '.join(parts)
