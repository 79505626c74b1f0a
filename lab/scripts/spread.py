"""Measures how far runs with other numbers of features depart from a reference run.

    python lab/scripts/spread.py SEQUENCE [SEQUENCE ...] [--filter none] [--reference hoid+]
        [--detector yolox_nano] [--runs 20] [--calibration camera.yaml] [--depth-factor 1000]

A SEQUENCE is a TUM folder or a bag. The runs have 920 to 1,080 features, evenly spread; the
reference has 1,000. Each run is aligned to the reference, and its error is the distance of its
most distant image: a random draw that decides where the camera slips shows in it, not in a mean.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.options import add_folder_arguments, chosen_camera, depth_units_per_m
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bringup.evaluate.evaluation import align
from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import HoidError
from hoid_common.values import Trajectory

_LEAST, _MOST = 920, 1080
_MM = 1e3


class Run(NamedTuple):
    """Trajectories of one run, and the share of the images that have a pose in the main map."""

    online: Trajectory
    final: Trajectory
    coverage: float


def run(sequence: Sequence, config: RunConfig, num_features: int) -> Run:
    """Run every frame with a number of features."""
    config = config.updated({'filter.extraction.num_features': num_features})
    pipeline = OfflinePipeline(sequence, config)
    for frame in sequence:
        pipeline.process(frame)
    result = pipeline.finish(sequence, {})
    return Run(result.online, result.final, len(result.final) / len(sequence))


def row(name: str, runs: dict[int, Run], reference: Run) -> str:
    """Return a row of the printed table."""
    cells = []
    for kind in ('online', 'final'):
        worst_mm = [
            _MM * align(getattr(one, kind), getattr(reference, kind)).error_m.max()
            for one in runs.values()
        ]
        cells.append(f'{np.median(worst_mm):.1f} | {max(worst_mm):.1f}')
    covered = [one.coverage for one in runs.values()]
    return f'| {name} | {" | ".join(cells)} | {min(covered):.3f} to {max(covered):.3f} |\n'


def main() -> int:
    """Print a table with a row for each sequence."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('sequence', nargs='+', type=Path)
    parser.add_argument('--filter', default='none')
    parser.add_argument('--reference', default='hoid+')
    parser.add_argument('--detector', default='yolox_nano')
    parser.add_argument('--runs', type=int, default=20)
    add_folder_arguments(parser)
    args = parser.parse_args()
    base = RunConfig().updated({'detector.model': args.detector})
    reference = base.updated({'filter.strategy': args.reference})
    config = base.updated({'filter.strategy': args.filter})
    counts = np.linspace(_LEAST, _MOST, args.runs).round().astype(int).tolist()
    sys.stdout.write(
        '| sequence | online: worst image, median [mm] | most | final: median | most '
        '| coverage |\n'
        '|---|---|---|---|---|---|\n'
    )
    try:
        for path in args.sequence:
            sequence = open_sequence(path, chosen_camera(args), depth_units_per_m(args))
            runs = {n: run(sequence, config, n) for n in counts}
            truth = run(sequence, reference, RunConfig().filter.extraction.num_features)
            sys.stdout.write(row(path.name, runs, truth))
            sys.stdout.flush()
    except HoidError as error:
        sys.stderr.write(f'spread: {error}\n')
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
