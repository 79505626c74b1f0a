"""`hoid bench covariances`: whether the published covariances are consistent with the errors.

The table shows the normalized squared error per degree of freedom of the relative pose over one
second, and of the mean velocity since the last image: 1 is consistent, more is overconfident. A
recorded reference has errors too. Further columns add its pose noise, and show the offsets of its
clock at which its rotations and its translations agree best. The last column assumes instead that
motion capture has an error of 1 mm and 0.5 degrees over a motion.
"""

from __future__ import annotations

from collections.abc import Sequence as List
from dataclasses import replace
from pathlib import Path

import numpy as np

from hoid_bags.sequence import Sequence, open_sequence
from hoid_benchmarks.consistency import (
    Consistency,
    Estimates,
    ReferenceNoise,
    consistency,
    reference_noise,
)
from hoid_benchmarks.plan.sequences import Store
from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common.errors import InputError
from rgbd_slam.robot_frames import RobotPose

RECORDINGS = ('fr1_xyz', 'synth-1', 'empty_room', 'crowd', 'group-1', 'moving-robot')
_YOUNG = 5  # images until the pose noise has been measured
# Covariance of one pose if a motion between two has a total error of 0.5 degrees and 1 mm.
_CAPTURED = np.diag(np.square([np.radians(0.5)] * 3 + [1e-3] * 3)) / 6
_HEADER = (
    '| recording | pose | twist | error over 1 s | claimed | reference jitters | its clocks '
    '| pose with it | twist with it | pose with 1 mm, 0.5° |\n|' + 10 * '---|'
)


def covariance_report(names: List[str], store: Store) -> str:
    """Return a table that compares errors with published covariances.

    Args:
        names: Recordings with ground truth; empty means the default ones.
        store: Folders of the recordings; missing rendered ones are made.

    Raises:
        InputError: A recording is missing, or has no ground truth.
    """
    return '\n'.join(
        [_HEADER, *(_row(name, store.find(name)) for name in names or RECORDINGS), '']
    )


def _row(name: str, path: Path) -> str:
    sequence = open_sequence(path)
    truth = sequence.ground_truth
    if truth is None:
        raise InputError(f'{name}: has no ground truth')
    estimates = tracked(sequence)
    noise = reference_noise(estimates, truth)
    alone, both, captured = (
        consistency(estimates, truth, of)
        for of in (None, noise, replace(noise, covariance=_CAPTURED))
    )
    exact = sequence.true_detections is not None
    reference = [*_reference_cells(noise, both), f'{captured.pose:.2f}']
    cells = [name, *_cells(alone), *(5 * ['exact'] if exact else reference)]
    return f'| {" | ".join(cells)} |'


def tracked(sequence: Sequence) -> Estimates:
    """Return the published estimates of a recording, run with ground-truth boxes if it has any."""
    exact = {'filter.strategy': 'hoid+', 'detector.model': TRUTH}
    config = exact if sequence.true_detections is not None else {'filter.strategy': 'none'}
    pipeline = OfflinePipeline(sequence, RunConfig().updated(config))
    done = [(frame.stamp_ns, pipeline.process(frame).pose) for frame in sequence]
    poses: list[tuple[int, RobotPose]] = [(at, pose) for at, pose in done if pose is not None]
    stamps_ns, kept = zip(*poses[_YOUNG:], strict=True)
    return Estimates(
        np.array(stamps_ns),
        np.array([pose.T_odom_base for pose in kept]),
        np.array([pose.covariance for pose in kept]),
        np.array([pose.twist for pose in kept]),
        np.array([pose.twist_covariance for pose in kept]),
    )


def _cells(found: Consistency) -> list[str]:
    return [
        f'{found.pose:.2f}',
        f'{found.twist:.2f}',
        f'{1e3 * found.error_m:.1f} mm, {found.error_deg:.2f}°',
        f'{1e3 * found.sigma_m:.1f} mm, {found.sigma_deg:.2f}°',
    ]


def _reference_cells(noise: ReferenceNoise, both: Consistency) -> list[str]:
    sigma = np.sqrt(np.diag(noise.covariance))
    way_mm, turn_deg = 1e3 * np.linalg.norm(sigma[3:]), np.degrees(np.linalg.norm(sigma[:3]))
    return [
        f'{way_mm:.1f} mm, {turn_deg:.2f}°',
        f'{1e3 * noise.rotation_clock_s:+.0f}, {1e3 * noise.translation_clock_s:+.0f} ms',
        f'{both.pose:.2f}',
        f'{both.twist:.2f}',
    ]
