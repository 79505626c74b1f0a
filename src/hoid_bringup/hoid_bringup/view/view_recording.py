"""Logging of a recording's images, with the results of the filter, for the viewer."""

from __future__ import annotations

import numpy as np

from hoid_bags.progress import progress
from hoid_bags.sequence import Sequence
from hoid_bags.tum.association import MAX_PAIR_GAP_NS
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_bringup.view.view_log import TRUE_PATH, ViewLog
from hoid_common.values import FloatArray, Trajectory
from hoid_filter.feature_filter import FeatureFilter


def log_recording(log: ViewLog, sequence: Sequence, config: RunConfig) -> None:
    """Filter and log all images of a recording, and its true trajectory if it has one.

    Args:
        sequence: The recording. Images get the poses of its ground truth.

    Raises:
        HoidError: An image or the detector model is invalid.
    """
    if sequence.ground_truth is not None:
        log.path(TRUE_PATH, sequence.ground_truth)
    log_images(log, sequence, config, sequence.ground_truth)


def log_images(
    log: ViewLog, sequence: Sequence, config: RunConfig, poses: Trajectory | None
) -> None:
    """Filter every image of a recording, and log it with the results.

    Args:
        poses: Camera poses. Each image gets the pose nearest in time, or none if no pose is within
            0.02 s. None: the images have no poses.

    Raises:
        HoidError: An image or the detector model is invalid.
    """
    detect = detection_source(sequence, config)
    feature_filter = FeatureFilter(config.filter, sequence.camera)
    log.camera(sequence.camera)
    for frame in progress(sequence, len(sequence), 'frames'):
        result = feature_filter.process(frame, detect(frame), for_picture=True)
        log.frame(frame, result, None if poses is None else _pose_at(poses, frame.stamp_ns))


def with_ground_truth_boxes(config: RunConfig, sequence: Sequence) -> RunConfig:
    """Return the configuration, changed to use ground-truth boxes if that is possible.

    It is unchanged if it names a detector model or the recording has no ground-truth boxes.
    """
    if config.detector.model or sequence.true_detections is None:
        return config
    return config.updated({'detector.model': TRUTH})


def _pose_at(poses: Trajectory, stamp_ns: int) -> FloatArray | None:
    """Return the pose (4, 4) nearest to a stamp; None if none is within 0.02 s."""
    gap_ns = np.abs(poses.stamps_ns - stamp_ns)
    if len(gap_ns) == 0 or gap_ns.min() > MAX_PAIR_GAP_NS:
        return None
    return np.asarray(poses.T_world_camera[gap_ns.argmin()])
