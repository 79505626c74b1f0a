"""`hoid bench live`: what each process uses while a recording is played in real time."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.jobs.code import Code
from hoid_benchmarks.live.cases import CASES, PUBLISHING, QUICK, LiveCase
from hoid_benchmarks.live.live_case import PROCESSES, LiveResult, run_case
from hoid_benchmarks.live.publishing import publishing
from hoid_benchmarks.live.usage import Usage
from hoid_benchmarks.plan.sequences import Store
from hoid_bringup.cli import main as hoid
from hoid_bringup.run.provenance import machine
from hoid_common.errors import HoidError, InputError

_ROOT = Path(__file__).parents[3]
_LIMIT_S, _QUICK_S = 20.0, 5.0  # chosen: time that is measured of each case
_HEADS = (
    *('case', 'filter', 'subscribed', 'cores', 'Hz', 'process'),
    *('CPU s/s', 'CPU ms/image', 'PSS MB', 'wake-ups /s', 'latency ms, median / p95', 'images'),
)


def live_report(
    only: Sequence[str], store: Store, out: Path, detector: str | None, *, quick: bool = False
) -> Iterator[str]:
    """Run cases and yield the report as Markdown, line by line.

    Args:
        only: Names of the cases; empty means all.
        store: The recordings.
        out: Folder of bags and logs.
        detector: Model of the detector; None: the one that the nodes find.
        quick: Whether to run only the part that takes a minute.

    Raises:
        InputError: There is no such case.
    """
    if unknown := sorted(set(only) - {*CASES, PUBLISHING}):
        raise InputError(f'no case {unknown[0]}: {", ".join((*CASES, PUBLISHING))}')
    out.mkdir(parents=True, exist_ok=True)
    names = only or (QUICK if quick else (*CASES, PUBLISHING))
    known = {**CASES, **QUICK}
    cases = {name: known[name] for name in names if name in known}
    if cases:
        yield _line(_HEADS)
        yield _line(['---'] * len(_HEADS))
        limit_s = _QUICK_S if quick else _LIMIT_S
        for name, case in cases.items():
            yield from _case_lines(name, case, store, out, detector, limit_s)
        load = os.getloadavg()[1]
        commit = Code.of(_ROOT).commit
        yield f'\nMade at commit {commit}, on {machine()}; load average {load:.1f}.\n'
    if PUBLISHING in names:
        yield f'\n{publishing(0).table()}'


def _case_lines(
    name: str, case: LiveCase, store: Store, out: Path, detector: str | None, limit_s: float
) -> Iterator[str]:
    try:
        bag = BagSequence(_bag(case.sequence, store, out))
        result = run_case(case, bag, detector, out / name, limit_s)
    except HoidError as error:
        yield _line([name, str(error), *[''] * (len(_HEADS) - 2)])
        return
    yield from (_line(cells) for cells in table_rows(name, case, result))


def table_rows(name: str, case: LiveCase, result: LiveResult) -> Iterator[list[str]]:
    """Yield the cells of the sum of all processes, and of each process."""
    subscribed = 'all' if case.everything else 'odometry'
    first = [name, case.strategy, subscribed, str(case.num_cores), f'{case.rate_hz:g}']
    median, p95 = result.latency_ms
    usage = result.usage.values()
    images_hz = result.num_images / result.duration_s
    share = f'{100 * result.num_images / result.num_shown:.0f} %'
    total = Usage(*map(sum, zip(*usage, strict=True)))
    yield [*first, 'all', *_cells(total, images_hz), f'{median:.0f} / {p95:.0f}', share]
    for process in PROCESSES:
        if process in result.usage:
            cells = _cells(result.usage[process], images_hz)
            yield [*[''] * len(first), process, *cells, '', '']


def _cells(used: Usage, images_hz: float) -> list[str]:
    per_image = f'{1e3 * used.cpu / images_hz:.1f}'
    return [f'{used.cpu:.2f}', per_image, f'{used.pss_mb:.0f}', f'{used.wake_ups_hz:.0f}']


def _bag(sequence: str, store: Store, out: Path) -> Path:
    """Return a bag of a sequence; a folder is converted, with images as a camera sends them."""
    path = store.find(sequence)
    if (path / 'metadata.yaml').exists():
        return path
    bag = out / f'{sequence}.bag'
    if not bag.exists():
        try:
            hoid(['convert', str(path), str(bag), '--rgb', 'raw', '--depth', 'raw'])
        except SystemExit as end:
            if end.code:
                raise
    return bag


def _line(cells: Sequence[str]) -> str:
    return f'| {" | ".join(cells)} |\n'
