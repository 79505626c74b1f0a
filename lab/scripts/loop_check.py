"""Checks every loop closure against the ground truth.

    python lab/scripts/loop_check.py SEQUENCE [SEQUENCE ...] [--seeds 1] [--filter hoid+]
        [--detector truth] [--without]

A SEQUENCE is a TUM folder or a bag with ground truth. A loop closure, a return to a known place
and a merge of maps each estimate the relative pose of two images. It is false if it differs from
the ground truth by more than 0.1 m or 3 degrees. With `--without`, each run is repeated without
loop closing, for comparison of the ATE.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.sequence import Sequence, open_sequence
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.run_config import RunConfig
from hoid_common import se3
from hoid_common.errors import HoidError
from hoid_common.values import FloatArray, Trajectory
from rgbd_slam.loops.loop_closer import Join, LoopEvent

_FALSE_M, _FALSE_DEG = 0.1, 3.0
_MM = 1e3
_JOINS = logging.getLogger('rgbd_slam.loops.loop_closer')


class Checked(NamedTuple):
    """A join with the error of its relative pose."""

    event: LoopEvent
    error_m: float
    error_deg: float

    @property
    def is_false(self) -> bool:
        """Return whether the error of the relative pose exceeds the limits."""
        return self.error_m > _FALSE_M or self.error_deg > _FALSE_DEG


class Outcome(NamedTuple):
    """Errors, coverage and joins of a run."""

    ate_m: float
    ate_online_m: float
    coverage: float
    num_keyframes: int
    joins: list[Checked]


class _Listener(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.joins: list[Join] = []

    def emit(self, record: logging.LogRecord) -> None:
        if isinstance(record.args, tuple):
            self.joins += [arg for arg in record.args if isinstance(arg, Join)]


@contextmanager
def listening() -> Iterator[list[Join]]:
    """Yield a list to which every join is appended until the block is left."""
    handler, level = _Listener(), _JOINS.level
    _JOINS.addHandler(handler)
    _JOINS.setLevel(logging.INFO)
    try:
        yield handler.joins
    finally:
        _JOINS.setLevel(level)
        _JOINS.removeHandler(handler)


def checked(join: Join, truth: Trajectory) -> Checked:
    """Return a join with its error, by the ground truth at the stamps of its images."""
    T_place, T_camera = (_pose_at(truth, ns) for ns in (join.place_stamp_ns, join.stamp_ns))
    T_error = se3.inverse(se3.inverse(T_place) @ T_camera) @ join.edge.T_first_second
    turn_rad = np.linalg.norm(se3.log(T_error)[:3])
    way_m = float(np.linalg.norm(T_error[:3, 3]))
    return Checked(join.event, way_m, float(np.degrees(turn_rad)))


def _pose_at(truth: Trajectory, stamp_ns: int) -> FloatArray:
    nearest = np.argmin(np.abs(truth.stamps_ns - stamp_ns))
    pose: FloatArray = truth.T_world_camera[nearest]
    return pose


def run(sequence: Sequence, config: RunConfig) -> Outcome:
    """Run every frame and check all joins."""
    truth = sequence.ground_truth
    if truth is None:
        raise SystemExit(f'{sequence.name} has no ground truth')
    with listening() as joins:
        pipeline = OfflinePipeline(sequence, config)
        for frame in sequence:
            pipeline.process(frame)
        result = pipeline.finish(sequence, {})
    return Outcome(
        evaluate(result.final, truth).ate_rmse_m,
        evaluate(result.online, truth).ate_rmse_m,
        len(result.final) / len(sequence),
        result.status.keyframes,
        [checked(join, truth) for join in joins],
    )


def row(name: str, seed: int, outcome: Outcome, ate_without_m: float | None) -> str:
    """Return a row of the printed table."""
    joins = outcome.joins
    counts = [sum(join.event is event for join in joins) for event in _EVENTS]
    worst_m = max((join.error_m for join in joins), default=0.0)
    worst_deg = max((join.error_deg for join in joins), default=0.0)
    without = '' if ate_without_m is None else f'{_MM * ate_without_m:.1f}'
    return (
        f'| {name} | {seed} | {" / ".join(map(str, counts))} '
        f'| {sum(join.is_false for join in joins)} | {_MM * worst_m:.0f} mm, {worst_deg:.2f} deg '
        f'| {without} | {_MM * outcome.ate_m:.1f} | {_MM * outcome.ate_online_m:.1f} '
        f'| {outcome.coverage:.3f} | {outcome.num_keyframes} |\n'
    )


_EVENTS = (LoopEvent.CLOSED, LoopEvent.REJOINED, LoopEvent.MERGED)
_HEAD = (
    '| sequence | seed | closed / rejoined / merged | false | worst error '
    '| ATE mm without loops | ATE mm | online | coverage | keyframes |\n'
    '|---|---|---|---|---|---|---|---|---|---|\n'
)


def main() -> int:
    """Print a table with a row for each run; return status 1 if any join is false."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('sequence', nargs='+', type=Path)
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--filter', default='none')
    parser.add_argument('--detector', default='')
    parser.add_argument('--without', action='store_true')
    args = parser.parse_args()
    base = RunConfig().updated({'filter.strategy': args.filter, 'detector.model': args.detector})
    sys.stdout.write(_HEAD)
    num_false = 0
    try:
        for path in args.sequence:
            sequence = open_sequence(path)
            for seed in range(args.seeds):
                config = base.updated({'slam.seed': seed})
                outcome = run(sequence, config)
                apart = config.updated({'slam.places.loops.enabled': False})
                without_m = run(sequence, apart).ate_m if args.without else None
                sys.stdout.write(row(path.name, seed, outcome, without_m))
                sys.stdout.flush()
                num_false += sum(join.is_false for join in outcome.joins)
    except HoidError as error:
        sys.stderr.write(f'loop_check: {error}\n')
        return 1
    return 1 if num_false else 0


if __name__ == '__main__':
    sys.exit(main())
