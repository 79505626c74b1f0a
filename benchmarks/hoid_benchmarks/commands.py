"""`hoid bench`: the speed of one stage, or the experiments and their report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hoid_benchmarks.check import check
from hoid_benchmarks.engine import Engine
from hoid_benchmarks.literature import published
from hoid_benchmarks.plan import load_plan
from hoid_benchmarks.report import write_report
from hoid_benchmarks.sequences import Store
from hoid_benchmarks.speed import STAGES, time_stage
from hoid_common.errors import HoidError

_ROOT = Path(__file__).resolve().parents[2]


def add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the experiments."""
    parser.add_argument(
        'what',
        nargs='?',
        default='full',
        metavar='WHAT',
        help=f'a stage to time ({", ".join(STAGES)}), or experiments: full, quick, a YAML file',
    )
    parser.add_argument('--quick', action='store_true', help='the same as "quick": 10 minutes')
    parser.add_argument('--only', action='append', default=[], help='run just this experiment')
    parser.add_argument('--out', type=Path, default=Path('out/bench'), help='folder of results')
    parser.add_argument('--data', type=Path, help='folder of unpacked official sequences')
    parser.add_argument('--cluster', default='', help='address of a Dask scheduler')
    parser.add_argument('--check', action='store_true', help='fail when a stored bound is broken')


def bench_command(args: argparse.Namespace) -> None:
    """Time a stage; or run what has not run yet, write the report, and check bounds if asked.

    Raises:
        HoidError: A bound is broken, or the experiments cannot be read.

    """
    store = Store(_ROOT.parent / 'shared', args.out / 'sequences', args.data)
    store.made.mkdir(parents=True, exist_ok=True)
    if args.what in STAGES and not args.quick:
        sys.stdout.write(time_stage(args.what, store))
        return
    plan = load_plan('quick' if args.quick else args.what).only(args.only)
    folder: Path = args.out / plan.name
    results = Engine(folder, store, args.cluster).run(plan.jobs())
    page = write_report(plan, results, folder, (published(),))
    failed = sum(not r.ok for r in results.values())
    sys.stdout.write(f'{len(results) - failed} runs, {failed} failed: {page}\n')
    broken = check(results.values()) if args.check else []
    if broken:
        raise HoidError('; '.join(broken))
