"""A recording, image by image, with what the filter sees and decides."""

from __future__ import annotations

import numpy as np

from hoid_bags.progress import progress
from hoid_bags.sequence import Sequence
from hoid_bags.tum.association import MAX_PAIR_GAP_NS
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.run_config import TRUTH as EXACT
from hoid_bringup.run.run_config import RunConfig
from hoid_bringup.view.view_log import TRUTH, ViewLog
from hoid_common.values import FloatArray, Trajectory
from hoid_filter.feature_filter import FeatureFilter


def log_recording(log: ViewLog, sequence: Sequence, config: RunConfig) -> None:
    """Show a recording by itself, along the true path if it has one."""
    if sequence.ground_truth is not None:
        log.path(TRUTH, sequence.ground_truth)
    log_images(log, sequence, config, sequence.ground_truth)


def log_images(
    log: ViewLog, sequence: Sequence, config: RunConfig, poses: Trajectory | None
) -> None:
    """Show every image.

    Args:
        poses: Of the camera; an image takes the one nearest in time, within 0.02 s.

    Raises:
        HoidError: An image or the detector cannot be used.
    """
    detect = detection_source(sequence, config)
    judge = FeatureFilter(config.filter, sequence.camera)
    log.camera(sequence.camera)
    for frame in progress(sequence, len(sequence), 'frames'):
        result = judge.process(frame, detect(frame), for_picture=True)
        log.frame(frame, result, None if poses is None else _pose_at(poses, frame.stamp_ns))


def with_exact_boxes(config: RunConfig, sequence: Sequence) -> RunConfig:
    """Return the configuration with a rendered bag's exact boxes, unless a detector is named."""
    if config.detector.model or sequence.true_detections is None:
        return config
    return config.updated({'detector.model': EXACT})


def _pose_at(poses: Trajectory, stamp_ns: int) -> FloatArray | None:
    gap_ns = np.abs(poses.stamps_ns - stamp_ns)
    if len(gap_ns) == 0 or gap_ns.min() > MAX_PAIR_GAP_NS:
        return None
    return np.asarray(poses.T_world_camera[gap_ns.argmin()])
