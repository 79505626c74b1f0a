"""Output files of a run, which appear in the output folder together when all are complete."""

from __future__ import annotations

import json
from pathlib import Path

from hoid_bringup.evaluate.evaluation import AlignedTrajectory, align
from hoid_bringup.evaluate.plots import plot_run
from hoid_bringup.run.summary import RunResult, Summary, summarize
from hoid_common.errors import InputError
from hoid_common.io.files import staged
from hoid_common.io.tum_text import write_tum
from hoid_common.values import Trajectory
from hoid_scene.export import write_ply
from hoid_scene.grid.grid import write_map_server

# Names of the files in the output folder of a run.
SUMMARY = 'summary.json'
FINAL = 'trajectory.txt'
ONLINE = 'trajectory_online.txt'
KEYFRAMES = 'keyframes.txt'
MAP = 'map.ply'
CLOUD = 'cloud.ply'
GRID = 'grid'  # .pgm and .yaml
PICTURE = 'trajectory.png'


def write_outputs(out_dir: Path, result: RunResult) -> Summary:
    """Write all files of a run into a folder, which is created if needed; return the summary.

    Files with other names are kept. No partial file remains if the folder cannot be written.
    """
    summary = summarize(result)
    with staged(out_dir) as stage:
        write_tum(stage / FINAL, result.final)
        write_tum(stage / ONLINE, result.online)
        write_tum(stage / KEYFRAMES, result.keyframes)
        write_ply(stage / MAP, result.map_points_m)
        if result.cloud is not None:
            write_ply(stage / CLOUD, *result.cloud)
        if result.grid is not None:
            write_map_server(result.grid, stage / GRID)
        aligned = _aligned_or_none(result.final, result.ground_truth)
        plot_run(stage / PICTURE, result.final, aligned, _title(summary))
        (stage / SUMMARY).write_text(summary.to_json(), encoding='utf-8')
    return summary


def num_frames_of_run(trajectory: Path) -> int | None:
    """Return `frames_total` in the summary beside `trajectory.txt` or `trajectory_online.txt`.

    None if the file has another name, or there is no valid summary beside it.
    """
    path = trajectory.parent / SUMMARY
    if trajectory.name not in (FINAL, ONLINE) or not path.is_file():
        return None
    try:
        number = json.loads(path.read_text(encoding='utf-8'))['frames_total']
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return number if isinstance(number, int) and number > 0 else None


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
