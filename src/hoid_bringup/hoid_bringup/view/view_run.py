"""Logging of the results of a run for the viewer."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hoid_bags.sequence import Sequence
from hoid_bringup.evaluate.evaluation import align
from hoid_bringup.run import outputs
from hoid_bringup.run.run_config import RunConfig
from hoid_bringup.view.view_log import ESTIMATED_PATH, TRUE_PATH, ViewLog
from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.io.trajectory_io import read_tum
from hoid_common.values import Trajectory
from hoid_scene.export import read_ply


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """Results in the output folder of `hoid run` or `hoid replay`."""

    folder: Path
    recording: Path | None  # path of the recording at the time of the run; None: unknown
    config: RunConfig
    final: Trajectory
    keyframes: Trajectory


def is_run(path: Path) -> bool:
    """Return whether a path is the output folder of a run: it contains `summary.json`."""
    return (path / outputs.SUMMARY).is_file()


def open_run(folder: Path) -> FinishedRun:
    """Read the results of a run from its output folder.

    Raises:
        HoidError: A file is missing or damaged, or a parameter in the summary is invalid.
    """
    path = folder / outputs.SUMMARY
    try:
        summary = json.loads(path.read_text(encoding='utf-8'))
        options, recording = dict(summary['options']), summary.get('recording')
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f'{path}: is no summary of a run ({error}): give a folder that "hoid run" has written'
        ) from error
    return FinishedRun(
        folder,
        Path(recording) if recording else None,
        RunConfig.from_summary_options(options),
        read_tum(folder / outputs.FINAL),
        read_tum(folder / outputs.KEYFRAMES),
    )


def log_run(log: ViewLog, run: FinishedRun, sequence: Sequence | None) -> None:
    """Log the map, the trajectories and the keyframes of a run.

    The true trajectory is aligned to the estimate; it is left out if that is not possible.

    Args:
        sequence: The recording, from which ground truth and camera are taken; None: it is missing.

    Raises:
        InputError: A file of the run is missing or damaged.
    """
    log.path(ESTIMATED_PATH, run.final)
    log.keyframes(run.keyframes.T_world_camera, sequence.camera if sequence else None)
    log.points(read_ply(run.folder / outputs.MAP).points_m)
    dense = run.folder / outputs.CLOUD
    if dense.is_file():
        log.cloud(*read_ply(dense))
    if sequence is not None and sequence.ground_truth is not None:
        with suppress(InputError):  # it cannot be aligned to so few poses, or to poses on a line
            log.path(TRUE_PATH, _in_map(sequence.ground_truth, run.final))


def _in_map(truth: Trajectory, estimate: Trajectory) -> Trajectory:
    """Return the true poses in the map frame of the run, after alignment to the estimate.

    Raises:
        InputError: Too few poses are associated, or they do not determine the alignment.
    """
    T_map_world = se3.inverse(align(estimate, truth).T_world_map)
    return Trajectory(truth.stamps_ns, T_map_world @ truth.T_world_camera)
