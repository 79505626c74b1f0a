"""What another commit costs live, against this one: both in turns, in one run on one machine.

    python3 lab/scripts/compare_commits.py COMMIT BAG --detector MODEL [--rounds 2]

The other commit is checked out and set up in `out/COMMIT` once, which takes some minutes. Then
each commit plays the bag in real time (`hoid replay`), on two cores and on one, with the player on
the same cores. Do not run it with `./hoid dev`: the commits have environments of their own.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import statistics
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[2]
_CORES = (2, 1)
_RATE_HZ = 30.0  # of the images in the bag

Values = Mapping[str, float]


def values_of(summary: Mapping[str, Any], cpu_s: float) -> dict[str, float]:
    """Return what is compared of a replay, from its summary and its processor time.

    The processor time of an image is that of the nodes while the bag is played. Memory is the sum
    of the nodes' resident memory; pages that they share count several times.
    """
    latency, nodes = summary['latency_ms'], summary['cpu_share_by_node']
    share = sum(share for name, share in nodes.items() if name != 'player' and share is not None)
    played_s = summary['frames_total'] / _RATE_HZ
    return {
        'images with a pose': summary['frames_tracked'],
        'latency, median ms': latency['median'],
        'latency, p95 ms': latency['p95'],
        'CPU ms/image': 1e3 * share * played_s / summary['frames_processed'],
        'CPU s with start and end': cpu_s,
        **{f'CPU s/s, {node}': share for node, share in nodes.items() if share is not None},
        'resident MB': summary['peak_rss_mb'],
        'ATE mm': 1e3 * (summary['ate_rmse_m'] or math.nan),
    }


def table(runs: Mapping[int, Sequence[tuple[Values, Values]]]) -> Iterator[str]:
    """Yield the lines of a Markdown table from (other, this) of each round, by number of cores.

    The ratio is that of the medians, this commit over the other.
    """
    yield '| cores | value | other | this | ratio |'
    yield '|--:|---|--:|--:|--:|'
    for cores, rounds in runs.items():
        for name in rounds[0][1]:
            columns = [
                [values.get(name, math.nan) for values in side]
                for side in zip(*rounds, strict=True)
            ]
            other, this = map(statistics.median, columns)
            shown = ['/'.join(f'{value:.4g}' for value in column) for column in columns]
            ratio = this / other if other else math.nan
            yield f'| {cores} | {name} | {shown[0]} | {shown[1]} | {ratio:.2f} |'


def _checkout(commit: str) -> Path:
    """Return the folder of another commit, in which `./hoid` is ready."""
    folder = _ROOT / 'out' / commit
    if not folder.exists():
        subprocess.run(['git', 'clone', '-q', str(_ROOT), str(folder)], check=True)
        subprocess.run(['git', '-C', str(folder), 'checkout', '-q', commit], check=True)
    for tree in (folder, _ROOT):
        subprocess.run([str(tree / 'hoid'), 'setup'], check=True)
        # This installs the packages that a replay needs beyond those of the nodes.
        subprocess.run(
            [str(tree / 'hoid'), 'evaluate', str(tree), str(tree)],
            check=False,
            capture_output=True,
        )
    return folder


def _replay(tree: Path, args: argparse.Namespace, out: Path) -> dict[str, float]:
    command = [str(tree / 'hoid'), 'replay', str(args.bag), '--out', str(out)]
    out.parent.mkdir(parents=True, exist_ok=True)
    before_s = _cpu_s()
    with out.with_suffix('.log').open('w') as log:
        subprocess.run(
            [*command, '--detector', str(args.detector)], check=True, stdout=log, stderr=log
        )
    cpu_s = _cpu_s() - before_s
    return values_of(json.loads((out / 'summary.json').read_text()), cpu_s)


def _cpu_s() -> float:
    """Return the processor time of all processes that have ended, with their start."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('commit')
    parser.add_argument('bag', type=Path)
    parser.add_argument('--detector', type=Path, required=True)
    parser.add_argument('--rounds', type=int, default=2)
    args = parser.parse_args()
    args.bag, args.detector = args.bag.resolve(), args.detector.resolve()
    trees = {'other': _checkout(args.commit), 'this': _ROOT}
    out = _ROOT / 'out' / 'compare'
    all_cores = sorted(os.sched_getaffinity(0))
    runs: dict[int, list[tuple[Values, Values]]] = {cores: [] for cores in _CORES}
    for number in range(args.rounds):
        for cores in _CORES:
            os.sched_setaffinity(0, all_cores[:cores])
            sides: dict[str, Values] = {}
            for name, tree in list(trees.items())[:: 1 if number % 2 == 0 else -1]:
                sides[name] = _replay(tree, args, out / f'{name}-{cores}-{number}')
            runs[cores].append((sides['other'], sides['this']))
            sys.stderr.write(f'round {number + 1} of {args.rounds}, {cores} core(s): done\n')
    sys.stdout.write('\n'.join(table(runs)) + '\n')


if __name__ == '__main__':
    main()
