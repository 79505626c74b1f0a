"""Logging of recordings and of results for the viewer."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hoid_bags.progress import progress
from hoid_bags.sequence import Sequence
from hoid_bags.tum.association import MAX_PAIR_GAP_NS
from hoid_bringup.evaluate.evaluation import align
from hoid_bringup.run import outputs
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_bringup.view.view_log import ESTIMATED_PATH, TRUE_PATH, ViewLog
from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.io.tum_text import read_tum
from hoid_common.values import FloatArray, Trajectory
from hoid_filter.feature_filter import FeatureFilter
from hoid_scene.export import read_ply
from hoid_scene.store import scene_file
from rgbd_slam.store import map_file


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """The results of `hoid run` or `hoid replay` in an output folder."""

    folder: Path
    recording: Path | None  # path of the recording at the time of the run; None: unknown
    config: RunConfig
    final: Trajectory
    keyframes: Trajectory


def is_run(path: Path) -> bool:
    return (path / outputs.SUMMARY).is_file()


def open_run(folder: Path) -> FinishedRun:
    """Read the results of a run from its output folder; HoidError if a file is damaged."""
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

    The true trajectory is aligned to the estimate, or left out if that is impossible.
    """
    log.path(ESTIMATED_PATH, run.final)
    log.keyframes(run.keyframes.T_world_camera, sequence.camera if sequence else None)
    log.points(read_ply(run.folder / outputs.MAP).points_m)
    dense = run.folder / outputs.CLOUD
    if dense.is_file():
        log.cloud(*read_ply(dense))
    if sequence is not None and sequence.ground_truth is not None:
        with suppress(InputError):  # too few poses, or poses on one line, cannot be aligned
            log.path(TRUE_PATH, _in_map(sequence.ground_truth, run.final))


def _in_map(truth: Trajectory, estimate: Trajectory) -> Trajectory:
    """Return the true poses in the map frame of the run, after alignment to the estimate."""
    T_map_world = se3.inverse(align(estimate, truth).T_world_map)
    return Trajectory(truth.stamps_ns, T_map_world @ truth.T_world_camera)


def log_map(log: ViewLog, path: Path) -> None:
    """Log dense map, keyframes and objects of a saved map; MapFileError if it is damaged."""
    content, scene = map_file.load(path), scene_file.read_file(path)
    keyframes = content.keyframes()
    mapper = scene_file.restored(scene, keyframes, content.camera)
    log.keyframes(keyframes.T_map_camera[keyframes.is_main], content.camera)
    log.cloud(*mapper.cloud())
    log.objects(mapper.mapped_objects())


def log_recording(log: ViewLog, sequence: Sequence, config: RunConfig) -> None:
    """Filter and log all images of a recording, with its true poses if they are known."""
    if sequence.ground_truth is not None:
        log.path(TRUE_PATH, sequence.ground_truth)
    log_images(log, sequence, config, sequence.ground_truth)


def log_images(
    log: ViewLog, sequence: Sequence, config: RunConfig, poses: Trajectory | None
) -> None:
    """Filter every image of a recording, and log it with the results.

    Ground-truth boxes are the detections if the recording has them and the configuration names no
    detector model. Each image gets the pose nearest in time, or none if no pose is within 0.02 s.
    """
    if not config.detector.model and sequence.true_detections is not None:
        config = config.updated({'detector.model': TRUTH})
    detect = detection_source(sequence, config)
    feature_filter = FeatureFilter(config.filter, sequence.camera)
    log.camera(sequence.camera)
    for frame in progress(sequence, len(sequence), 'frames'):
        result = feature_filter.process(frame, detect(frame), for_picture=True)
        log.frame(frame, result, None if poses is None else _pose_at(poses, frame.stamp_ns))


def _pose_at(poses: Trajectory, stamp_ns: int) -> FloatArray | None:
    """Return the pose (4, 4) nearest to a stamp; None if none is within 0.02 s."""
    gap_ns = np.abs(poses.stamps_ns - stamp_ns)
    if len(gap_ns) == 0 or gap_ns.min() > MAX_PAIR_GAP_NS:
        return None
    return np.asarray(poses.T_world_camera[gap_ns.argmin()])
