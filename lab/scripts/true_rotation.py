"""Measures what a perfect attitude would bring: the ATE with a prior of the true rotation.

    python lab/scripts/true_rotation.py SEQUENCE [SEQUENCE ...] [--seeds 2]

A SEQUENCE is a TUM folder or a bag with ground truth. Each run with the strategy `none` is
repeated with the true rotation as a prior of each tracked image (standard deviation 0.1 degrees).
The ratio of the errors bounds what any gyro can bring, since it knows no better rotation.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np

from hoid_bags.sequence import Sequence, open_sequence
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import HoidError
from hoid_common.values import RgbdFrame, Trajectory
from rgbd_slam.optimize.pose_optimizer import PosePrior
from rgbd_slam.tracking.odometry import Odometry

_SIGMA_RAD = np.deg2rad(0.1)  # chosen: below the 0.2 degrees of the prior of a gyro
_STEP = 0.01  # chosen: seeds differ by 1 % in the number of features


def true_prior(truth: Trajectory, first_ns: int, stamp_ns: int) -> PosePrior:
    """Return the prior of the true rotation of an image, in a map that starts at another one."""
    first, now = (np.argmin(np.abs(truth.stamps_ns - ns)) for ns in (first_ns, stamp_ns))
    T_camera_map, information = np.eye(4), np.zeros((6, 6))
    T_camera_map[:3, :3] = (
        truth.T_world_camera[now, :3, :3].T @ truth.T_world_camera[first, :3, :3]
    )
    information[:3, :3] = np.eye(3) / _SIGMA_RAD**2
    return PosePrior(T_camera_map, information)


class _Attitude:
    """The true rotation of the current image, which `Odometry.prior` returns."""

    def __init__(self, truth: Trajectory) -> None:
        self._truth = truth
        self._first_ns: int | None = None
        self._prior: PosePrior | None = None

    def show(self, frame: RgbdFrame) -> None:
        """Set the image whose rotation is given."""
        if self._first_ns is None:
            self._first_ns = frame.stamp_ns
        self._prior = true_prior(self._truth, self._first_ns, frame.stamp_ns)

    def prior(self) -> PosePrior | None:
        """Return the prior of the current image, in place of `Odometry.prior`."""
        return self._prior


def run(sequence: Sequence, config: RunConfig, *, is_rotation_known: bool) -> float:
    """Run every frame, and return the final ATE [m]."""
    truth = sequence.ground_truth
    if truth is None:
        raise SystemExit(f'{sequence.name} has no ground truth')
    attitude = _Attitude(truth)
    pipeline = OfflinePipeline(sequence, config)
    for frame in sequence:
        attitude.show(frame)
        if is_rotation_known:
            with patch.object(Odometry, 'prior', attitude.prior):
                pipeline.process(frame)
        else:
            pipeline.process(frame)
    return evaluate(pipeline.finish(sequence, {}).final, truth).ate_rmse_m


def main() -> int:
    """Print a table with a row for each run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('sequence', nargs='+', type=Path)
    parser.add_argument('--seeds', type=int, default=2)
    args = parser.parse_args()
    sys.stdout.write('| sequence | seed | ATE m | with the true rotation | ratio |\n')
    sys.stdout.write('|---|---|---|---|---|\n')
    base = RunConfig().updated({'filter.strategy': 'none'})
    budget = base.filter.extraction.num_features
    try:
        for path in args.sequence:
            sequence = open_sequence(path)
            for seed in range(args.seeds):
                features = round(budget * (1 + _STEP * seed))
                config = base.updated(
                    {'slam.seed': seed, 'filter.extraction.num_features': features}
                )
                free_m = run(sequence, config, is_rotation_known=False)
                known_m = run(sequence, config, is_rotation_known=True)
                sys.stdout.write(
                    f'| {path.name} | {seed} | {free_m:.4f} | {known_m:.4f} '
                    f'| {known_m / free_m:.2f} |\n'
                )
                sys.stdout.flush()
    except HoidError as error:
        sys.stderr.write(f'true_rotation: {error}\n')
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
