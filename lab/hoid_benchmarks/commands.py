"""`hoid bench`: experiments and their report, the time of one stage, or a special report."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path

from hoid_benchmarks.building.building import SCENARIOS, building_report
from hoid_benchmarks.building.tours.floor import SMALL
from hoid_benchmarks.building.tours.tour import DEFAULT_WAY_M
from hoid_benchmarks.faults.campaign import CAMPAIGNS, NIGHTLY, SLICE, Size, fault_report
from hoid_benchmarks.jobs.code import Code
from hoid_benchmarks.jobs.covariances import covariance_report
from hoid_benchmarks.jobs.engine import Engine
from hoid_benchmarks.jobs.masks import mask_report
from hoid_benchmarks.jobs.pairs import pair_report
from hoid_benchmarks.jobs.results import Result
from hoid_benchmarks.jobs.speed import STAGES, time_stage
from hoid_benchmarks.live.cases import CASES, PUBLISHING
from hoid_benchmarks.objects.list_report import object_report
from hoid_benchmarks.plan.official import packed_official
from hoid_benchmarks.plan.plan import Job, Plan, experiment_ids, load_plan, plan_names
from hoid_benchmarks.plan.sequences import Store
from hoid_benchmarks.planner.planner_report import NUM_ROOMS, planner_report
from hoid_benchmarks.publish.official import OFFICIAL, official_text, sequences_text
from hoid_benchmarks.publish.pages import (
    publish_faults,
    publish_report,
    results_path,
    write_pages,
)
from hoid_benchmarks.publish.results_file import keep
from hoid_benchmarks.report.check import check
from hoid_benchmarks.report.report import Report
from hoid_benchmarks.report.runs import RunList
from hoid_benchmarks.rooms.rooms import room_report
from hoid_common.errors import ConfigError, HoidError

_MASKS, _PAIRS, _ROOMS = 'masks', 'pairs', 'rooms'
_FAULTS, _COVARIANCES = 'faults', 'covariances'
_BUILDING, _LIVE, _PLANNER = 'building', 'live', 'planner'
_OBJECTS = 'objects'
REPORTS = (_MASKS, _PAIRS, _ROOMS, _OBJECTS, _FAULTS, _COVARIANCES, _BUILDING, _LIVE, _PLANNER)
"""Reports that `hoid bench` can write besides experiments and the times of stages."""
_ROOT = Path(__file__).resolve().parents[2]
_OUT = Path('out/bench')


def add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the experiments."""
    experiments = '; '.join(f'{n}: {", ".join(experiment_ids(n))}' for n in plan_names())
    parser.epilog = f'experiments for --only, by WHAT: {experiments}'
    _add_selection(parser)
    _add_sizes(parser)
    _add_execution(parser)


def _add_selection(parser: argparse.ArgumentParser) -> None:
    """Declare what to run."""
    add = parser.add_argument
    plans = ', '.join(name for name in plan_names() if name != OFFICIAL)
    add(
        'what',
        nargs='?',
        default='full',
        metavar='WHAT',
        help=f'experiments: {plans} (default: %(default)s) or a YAML file; '
        f'{OFFICIAL}: the tables of the paper, of the sequences in FOLDER; '
        f'a stage to time ({", ".join(STAGES)}); '
        f'{_MASKS}, {_PAIRS}: dynamic masks; {_ROOMS}: maps of rendered rooms; '
        f'{_OBJECTS}: object maps of real recordings; {_COVARIANCES}: published covariances; '
        f'{_FAULTS}: fault injection ({", ".join(CAMPAIGNS)}); '
        f'{_BUILDING}: a simulated building ({", ".join(SCENARIOS)}); '
        f'{_PLANNER}: drives among people, with and without the masks for Nav2; '
        f'{_LIVE}: what running nodes use ({", ".join((*CASES, PUBLISHING))})',
    )
    add(
        'folder',
        nargs='?',
        type=Path,
        metavar='FOLDER',
        help=f'{OFFICIAL}: folder of the unpacked sequences',
    )
    add('--quick', action='store_true', help='run the plan "quick", which takes a few minutes')
    add(
        '--only',
        action='append',
        default=[],
        metavar='ID',
        help='run only this experiment or scenario; may be repeated',
    )


def _add_sizes(parser: argparse.ArgumentParser) -> None:
    """Declare the sizes and seeds of generated experiments."""
    add = parser.add_argument
    add(
        '--seed',
        type=int,
        default=0,
        metavar='N',
        help='seed of the first case, room or building (default: %(default)s)',
    )
    add(
        '--cases',
        type=int,
        metavar='N',
        help='number of cases of each kind of fault, or minutes',
    )
    add(
        '--keyframes',
        type=int,
        action='append',
        default=[],
        metavar='N',
        help='building: size of the map; may be repeated',
    )
    add(
        '--delay',
        type=float,
        action='append',
        default=[],
        metavar='S',
        help='building: constant delay of the mapper in s; may be repeated',
    )
    add(
        '--floors', type=int, default=1, metavar='N',
        help='building: number of floors of the tour (default: %(default)s)',
    )  # fmt: skip
    add(
        '--way', type=float, default=DEFAULT_WAY_M, metavar='M',
        help='building: length of the tour in m (default: %(default)s)',
    )  # fmt: skip
    add(
        '--rooms', type=int, default=SMALL, metavar='N',
        help='building: number of rooms of the rendered floor (default: %(default)s)',
    )  # fmt: skip


def _add_execution(parser: argparse.ArgumentParser) -> None:
    """Declare where and how to run, and what to do with the results."""
    add = parser.add_argument
    add('--job', metavar='KEY', help='repeat the run with this key, which the report lists')
    add(
        '--report',
        action='store_true',
        help='report finished runs without running anything',
    )
    add('--detector', metavar='MODEL', help='detector model in place of those in the plan')
    add('--data', type=Path, metavar='DIR', help='folder of the unpacked TUM and Bonn sequences')
    add(
        '--out',
        type=Path,
        default=_OUT,
        metavar='DIR',
        help='folder for results (default: %(default)s)',
    )
    add(
        '--workers',
        type=int,
        default=0,
        metavar='N',
        help='number of parallel runs (default: one per core)',
    )
    add(
        '--cluster',
        default='',
        metavar='ADDRESS',
        help='address of a Dask scheduler',
    )
    add('--check', action='store_true', help='fail if a result exceeds its stored bound')
    add('--renew', action='store_true', help='repeat the runs of other versions of the code')
    add(
        '--publish', action='store_true',
        help='write the tables of README and docs/results',
    )  # fmt: skip


def bench_command(args: argparse.Namespace) -> None:
    """Write the requested report, or run the experiments that are not finished and report them.

    Raises:
        HoidError: A result exceeds its bound, or the experiments cannot be read.
    """
    _take_folder(args)
    without_store = {_FAULTS: _faults, _BUILDING: _building, _PLANNER: _planner}
    if args.what in without_store:
        without_store[args.what](args)
        return
    store = Store(_ROOT.parent / 'shared', args.out.absolute() / 'sequences', args.data)
    store.made.mkdir(parents=True, exist_ok=True)
    if args.what == _LIVE:
        _live(args, store)
    elif args.what in STAGES and not args.quick:
        sys.stdout.write(time_stage(args.what, store))
    elif args.what == _MASKS and not args.quick:
        sys.stdout.write(mask_report(args.only, store))
    elif args.what == _PAIRS and not args.quick:
        sys.stdout.write(pair_report(args.only, store))
    elif args.what == _COVARIANCES and not args.quick:
        sys.stdout.write(covariance_report(args.only, store))
    elif args.what == _OBJECTS and not args.quick:
        sys.stdout.write(object_report(args.only, store, args.detector, args.out / _OBJECTS))
    elif args.what == _ROOMS and not args.quick:
        text = room_report(args.only, store, args.detector)
        sys.stdout.write(text)
        if args.publish:
            publish_report(_ROOT, _ROOMS, text)
    else:
        _experiments(args, store)


def _take_folder(args: argparse.Namespace) -> None:
    """Use FOLDER as the folder of the official sequences."""
    if args.folder is not None and args.what != OFFICIAL:
        raise ConfigError(
            f'bench {args.what}: unexpected {args.folder}; only {OFFICIAL} has FOLDER'
        )
    args.data = args.folder or args.data
    if args.what == OFFICIAL and args.data is None:
        raise ConfigError(f'bench {OFFICIAL}: give the folder of the unpacked sequences')
    if args.what == OFFICIAL and args.publish:
        raise ConfigError(f'bench {OFFICIAL} has no page in docs/results: omit --publish')


def _faults(args: argparse.Namespace) -> None:
    size = SLICE if args.quick else NIGHTLY
    if args.cases is not None:
        size = Size(*[args.cases] * len(fields(Size)))
    text = fault_report(args.seed, size, args.only, args.out / _FAULTS)
    sys.stdout.write(text)
    if args.publish:
        publish_faults(_ROOT, text)


def _building(args: argparse.Namespace) -> None:
    folder = args.out / _BUILDING
    sys.stdout.writelines(
        building_report(
            args.only, args.seed, folder,
            quick=args.quick, delays_s=args.delay, sizes=args.keyframes,
            num_floors=args.floors, way_m=args.way, num_rooms=args.rooms,
        ),
    )  # fmt: skip


def _planner(args: argparse.Namespace) -> None:
    sys.stdout.write(planner_report(range(args.seed, args.seed + NUM_ROOMS)))


def _live(args: argparse.Namespace, store: Store) -> None:
    if args.publish and (args.only or args.quick):
        raise ConfigError('bench live --publish writes the whole page: omit --only and --quick')
    from hoid_benchmarks.live.live_report import live_report  # imports ROS

    lines = []
    for line in live_report(args.only, store, args.out / _LIVE, args.detector, quick=args.quick):
        sys.stdout.write(line)
        sys.stdout.flush()
        lines.append(line)
    if args.publish:
        publish_report(_ROOT, _LIVE, ''.join(lines))


def _experiments(args: argparse.Namespace, store: Store) -> None:
    what = 'quick' if args.quick else args.what
    here = store.official_sequences()
    plan = load_plan(what, here)
    plan = replace(plan, command=repeating_command(what, args))
    if what == OFFICIAL and args.data is not None:
        named = dict.fromkeys(job.sequence for job in plan.jobs())
        sys.stdout.write(sequences_text(here, list(named), packed_official(args.data)))
        plan = plan.on(here)
    if args.detector:
        plan = plan.with_detector(args.detector)
    folder = args.out / plan.name
    engine = Engine(
        folder, store, Code.of(_ROOT), args.cluster,
        only_this_code=args.check, workers=args.workers,
    )  # fmt: skip
    if args.job:
        _repeat(engine, plan.job(args.job))
        return
    found = engine.stored(plan.jobs())
    if not args.report:
        running = replace(engine, only_this_code=args.check or args.renew)
        found |= running.run(plan.only(args.only).jobs())
    results = {job: found[job] for job in plan.jobs() if job in found}  # in the plan's order
    page = Report(plan, results, folder, RunList(plan, store, _ROOT)).write()
    if what == OFFICIAL:
        sys.stdout.write(f'{official_text(plan, results)}\n')
    elif args.only:
        sys.stdout.writelines(_tables(plan.only(args.only), folder))
    sys.stdout.write(f'{_counted(results.values())}\n{page}\n')
    if args.publish:
        _publish(plan.only(args.only), results)
    if args.check and (broken := check(results.values())):
        raise HoidError('; '.join(broken))


def _tables(plan: Plan, folder: Path) -> Iterator[str]:
    """Yield the tables of the report of some experiments, without those that have no rows."""
    for experiment in plan.experiments:
        path = folder / 'tables' / f'{experiment.id}.md'
        if path.is_file():
            yield f'{experiment.title}\n\n{path.read_text()}\n'


def _publish(plan: Plan, results: Mapping[Job, Result]) -> None:
    kept = keep(plan, results, results_path(_ROOT, plan.name))
    incomplete = [e.id for e in plan.experiments if e.id not in kept]
    write_pages(_ROOT)
    for state, names in (('published', kept), ('incomplete, not published', incomplete)):
        if names:
            sys.stdout.write(f'{state}: {", ".join(names)}\n')


def repeating_command(what: str, args: argparse.Namespace) -> str:
    """Return the shell command, for the project's root, with the same plan, data and folder."""
    words = ['./hoid', 'bench', _from_root(what) if Path(what).suffix else what]
    if args.data is not None:
        words += [*([] if what == OFFICIAL else ['--data']), _from_root(args.data)]
    if (out := _from_root(args.out)) != str(_OUT):
        words += ['--out', out]
    return shlex.join(words)


def _from_root(path: str | Path) -> str:
    return os.path.relpath(path, _ROOT)


def _repeat(engine: Engine, job: Job) -> None:
    """Run one job, even if its result is stored, and print the main numbers of the result."""
    result = engine.repeat(job)
    if not result.ok:
        raise HoidError(result.error)
    names = ('ate_rmse_m', 'coverage', 'frames_processed', 'detector', 'masks')
    for name in names:
        if name in result.summary:
            sys.stdout.write(f'{name}  {result.summary[name]}\n')


def _counted(results: Iterable[Result]) -> str:
    every = list(results)
    missing = sum(r.missing for r in every)
    failed = sum(not r.ok for r in every) - missing
    return (
        f'{len(every) - failed - missing} runs done, {failed} failed, '
        f'{missing} without their sequence'
    )
