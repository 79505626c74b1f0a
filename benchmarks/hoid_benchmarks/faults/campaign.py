"""The campaign as a whole: which cases, how many, and its report."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hoid_bags.progress import progress
from hoid_benchmarks.faults.cases import Outcome, table, totals
from hoid_benchmarks.faults.files import KINDS, file_cases
from hoid_benchmarks.faults.kills import CONVERT, RECORD, kill_cases
from hoid_benchmarks.faults.samples import make_samples
from hoid_common.errors import ConfigError, HoidError

REPORT = 'faults.md'
FILES, KILLS, MESSAGES, NETWORK = 'files', 'kills', 'messages', 'network'
ROOMS = (FILES, KILLS, MESSAGES, NETWORK)


@dataclass(frozen=True)
class Size:
    """How many cases of each room."""

    files: int  # of each kind
    kills: int  # of each kind
    messages: int  # of each input
    network: int  # of each weather


NIGHTLY = Size(files=500, kills=50, messages=2000, network=5)
SLICE = Size(files=8, kills=4, messages=40, network=0)


def fault_report(seed: int, size: Size, only: Sequence[str], out: Path) -> str:
    """Run the campaign, write its table into a folder and return it.

    Args:
        seed: Of the first case; another one gives other cases.
        size: How many.
        only: Rooms to run; empty means all.
        out: The folder.

    Raises:
        ConfigError: A room does not exist.
        HoidError: A case did not end as it must.
    """
    for name in only:
        if name not in ROOMS:
            raise ConfigError(f'--only {name}: the campaign has {", ".join(ROOMS)}')
    outcomes = list(_outcomes(seed, size, only or ROOMS))
    text = table(outcomes)
    out.mkdir(parents=True, exist_ok=True)
    (out / REPORT).write_text(text, encoding='utf-8')
    if failed := totals(outcomes)['failed']:
        raise HoidError(f'{failed} of {len(outcomes)} cases failed, see {out / REPORT}')
    return text


def _outcomes(seed: int, size: Size, rooms: Sequence[str]) -> Iterator[Outcome]:
    with tempfile.TemporaryDirectory(prefix='hoid faults ') as scratch:
        folder = Path(scratch)
        samples = make_samples(folder / 'samples')
        if FILES in rooms:
            cases = file_cases(samples, folder / 'files', range(seed, seed + size.files))
            yield from progress(cases, size.files * len(KINDS), 'files', show=True)
        if KILLS in rooms:
            cases = kill_cases(samples, folder / 'kills', range(seed, seed + size.kills))
            yield from progress(cases, size.kills * len((CONVERT, RECORD)), 'kills', show=True)
        # The last: they start threads, which those before may not have. They need ROS.
        from hoid_benchmarks.faults.live.inputs import message_cases  # noqa: PLC0415
        from hoid_benchmarks.faults.live.network import network_cases  # noqa: PLC0415

        if NETWORK in rooms and size.network:
            yield from network_cases(folder / 'network', range(seed, seed + size.network))
        if MESSAGES in rooms:
            yield from message_cases(folder / 'live', range(seed, seed + size.messages))
