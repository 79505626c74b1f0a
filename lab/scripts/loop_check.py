"""Checks every loop closure, and what becomes of its candidates, against the ground truth.

    python lab/scripts/loop_check.py SEQUENCE [SEQUENCE ...] [--seeds 1] [--filter hoid+]
        [--detector truth] [--without] [--candidates] [--calibration camera.yaml]
        [--depth-factor 1000]

A SEQUENCE is a TUM folder or a bag. A loop closure, a return to a known place and a merge of maps
each estimate the relative pose of two images. It is false if it differs from the ground truth by
more than 0.1 m or 3 degrees. With `--without`, each run is repeated without loop closing, for
comparison of the ATE. With `--candidates`, a second table counts, by the reason of their
rejection, the keyframes that an image resembled, and with ground truth those of them that really
show the place of the image, at most 2 m and 40 degrees away.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.options import add_folder_arguments, chosen_camera, depth_units_per_m
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.run_config import RunConfig
from hoid_common import se3
from hoid_common.errors import HoidError
from hoid_common.values import FloatArray, Trajectory
from rgbd_slam.loops.loop_closer import Join, LoopEvent
from rgbd_slam.loops.surroundings import pose_distances
from rgbd_slam.places.place_finder import Candidate

_FALSE_M, _FALSE_DEG = 0.1, 3.0
_SEEN_M, _SEEN_RAD = 2.0, np.radians(40)  # two views this near show much of the same
_MM = 1e3
_SLAM = logging.getLogger('rgbd_slam')


class Checked(NamedTuple):
    """A join with the error of its relative pose."""

    event: LoopEvent
    error_m: float
    error_deg: float

    @property
    def is_false(self) -> bool:
        """Return whether the error of the relative pose exceeds the limits."""
        return self.error_m > _FALSE_M or self.error_deg > _FALSE_DEG


class Fate(NamedTuple):
    """The result of comparing an image with a keyframe that it resembles."""

    reason: str  # the kind of reason for a rejection
    is_in_other_map: bool
    is_same_place: bool | None  # by the ground truth


class Outcome(NamedTuple):
    """Errors, coverage and joins of a run; errors are NaN and no join is checked without truth."""

    ate_m: float
    ate_online_m: float
    coverage: float
    posed: float  # share of the images that have a pose in any map
    num_keyframes: int
    num_maps: int
    joins: list[Checked]
    fates: Counter[Fate]


class _Listener(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.joins: list[Join] = []
        self.candidates: list[Candidate] = []

    def emit(self, record: logging.LogRecord) -> None:
        for arg in record.args if isinstance(record.args, tuple) else ():
            if isinstance(arg, Join):
                self.joins.append(arg)
            elif isinstance(arg, Candidate):
                self.candidates.append(arg)


@contextmanager
def listening() -> Iterator[_Listener]:
    """Yield a listener to which every join and candidate is added until the block is left."""
    handler, level = _Listener(), _SLAM.level
    _SLAM.addHandler(handler)
    _SLAM.setLevel(logging.DEBUG)
    try:
        yield handler
    finally:
        _SLAM.setLevel(level)
        _SLAM.removeHandler(handler)


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
    truth, num_posed = sequence.ground_truth, 0
    with listening() as heard:
        pipeline = OfflinePipeline(sequence, config)
        for frame in sequence:
            num_posed += pipeline.process(frame).pose is not None
        result = pipeline.finish(sequence, {})
    ate_m, ate_online_m = (
        np.nan if truth is None else evaluate(trajectory, truth).ate_rmse_m
        for trajectory in (result.final, result.online)
    )
    return Outcome(
        ate_m,
        ate_online_m,
        len(result.final) / len(sequence),
        num_posed / len(sequence),
        result.status.keyframes,
        result.status.maps,
        [] if truth is None else [checked(join, truth) for join in heard.joins],
        Counter(fate(candidate, truth) for candidate in heard.candidates),
    )


def fate(candidate: Candidate, truth: Trajectory | None) -> Fate:
    """Return why a candidate was rejected, and whether it shows the place of the image."""
    reason, is_same_place = candidate.doubt.partition(':')[0], None
    if truth is not None:
        stamps_ns = candidate.place_stamp_ns, candidate.stamp_ns
        T_place, T_image = (_pose_at(truth, stamp_ns)[None] for stamp_ns in stamps_ns)
        apart_m, apart_rad = pose_distances(T_place, T_image)
        is_same_place = bool(apart_m[0, 0] < _SEEN_M and apart_rad[0, 0] < _SEEN_RAD)
    return Fate(reason or 'the same place', candidate.is_in_other_map, is_same_place)


def fates_table(fates: Counter[Fate]) -> str:
    """Return a table of the candidates of a run, with a row for each reason."""
    rows = []
    for reason in sorted({found.reason for found in fates}):
        of_reason = {found: n for found, n in fates.items() if found.reason == reason}
        same, other = (
            (
                sum(n for found, n in of_reason.items() if found.is_in_other_map is is_other),
                sum(
                    n
                    for found, n in of_reason.items()
                    if found.is_in_other_map is is_other and found.is_same_place
                ),
            )
            for is_other in (False, True)
        )
        rows.append(f'| {reason} | {same[0]} ({same[1]}) | {other[0]} ({other[1]}) |\n')
    return (
        '\n| candidates (really the same place) | in the same map | in another map |\n'
        f'|---|---|---|\n{"".join(rows)}\n'
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
        f'| {outcome.coverage:.3f} | {outcome.posed:.3f} '
        f'| {outcome.num_keyframes} | {outcome.num_maps} |\n'
    )


_EVENTS = (LoopEvent.CLOSED, LoopEvent.REJOINED, LoopEvent.MERGED)
_HEAD = (
    '| sequence | seed | closed / rejoined / merged | false | worst error '
    '| ATE mm without loops | ATE mm | online | coverage | in any map | keyframes | maps |\n'
    '|---|---|---|---|---|---|---|---|---|---|---|---|\n'
)


def main() -> int:
    """Print a table with a row for each run; return status 1 if any join is false."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('sequence', nargs='+', type=Path)
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--filter', default='none')
    parser.add_argument('--detector', default='')
    parser.add_argument('--without', action='store_true')
    parser.add_argument('--candidates', action='store_true')
    add_folder_arguments(parser)
    args = parser.parse_args()
    base = RunConfig().updated({'filter.strategy': args.filter, 'detector.model': args.detector})
    sys.stdout.write('' if args.candidates else _HEAD)
    num_false = 0
    try:
        for path in args.sequence:
            sequence = open_sequence(path, chosen_camera(args), depth_units_per_m(args))
            for seed in range(args.seeds):
                config = base.updated({'slam.seed': seed})
                outcome = run(sequence, config)
                apart = config.updated({'slam.places.loops.enabled': False})
                without_m = run(sequence, apart).ate_m if args.without else None
                sys.stdout.write(_HEAD if args.candidates else '')
                sys.stdout.write(row(path.name, seed, outcome, without_m))
                if args.candidates:
                    sys.stdout.write(fates_table(outcome.fates))
                sys.stdout.flush()
                num_false += sum(join.is_false for join in outcome.joins)
    except HoidError as error:
        sys.stderr.write(f'loop_check: {error}\n')
        return 1
    return 1 if num_false else 0


if __name__ == '__main__':
    sys.exit(main())
