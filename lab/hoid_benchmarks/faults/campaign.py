"""The fault-injection campaign: selection and number of cases, and the report."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hoid_bags.progress import progress
from hoid_benchmarks.faults.cases import Outcome, table, totals
from hoid_benchmarks.faults.files import KINDS, file_cases
from hoid_benchmarks.faults.kills import CONVERT, RECORD, kill_cases
from hoid_benchmarks.faults.samples import Samples, make_samples
from hoid_common.errors import ConfigError, HoidError

REPORT = 'faults.md'
FILES, KILLS, NETWORK, MESSAGES = 'files', 'kills', 'network', 'messages'
CONDITIONS, CAMERAS, DEATHS, SOAK = 'conditions', 'cameras', 'deaths', 'soak'
COMMANDS = 'commands'
CAMPAIGNS = (FILES, KILLS, NETWORK, MESSAGES, CONDITIONS, COMMANDS, CAMERAS, DEATHS, SOAK)


@dataclass(frozen=True)
class Size:
    """Number of cases of each kind of fault."""

    files: int  # for each kind of file
    kills: int  # for each writer
    network: int  # for each fault of the link
    messages: int  # for each input topic
    conditions: int  # for clocks, for loads and for disks
    commands: int  # for each case of a running command
    cameras: int  # for each camera
    deaths: int  # for each process
    soak: int  # minutes of the live run, and of the offline run


NIGHTLY = Size(
    files=500, kills=50, network=5, messages=2000, conditions=10, commands=5, cameras=1,
    deaths=50, soak=60,
)  # fmt: skip
SLICE = Size(
    files=4, kills=2, network=0, messages=10, conditions=1, commands=0, cameras=0, deaths=0,
    soak=0,
)  # fmt: skip


def fault_report(seed: int, size: Size, only: Sequence[str], out: Path) -> str:
    """Run the campaign, write its Markdown table into a folder, and return the table.

    Args:
        seed: Seed of the first case; the others follow it.
        size: Number of cases.
        only: Kinds of fault to inject; empty means all.
        out: Folder into which the table is written.

    Raises:
        ConfigError: There is no such kind of fault.
        HoidError: At least one case failed.
    """
    for name in only:
        if name not in CAMPAIGNS:
            raise ConfigError(f'--only {name}: the campaign has {", ".join(CAMPAIGNS)}')
    outcomes = list(_outcomes(seed, size, only or CAMPAIGNS))
    text = table(outcomes)
    out.mkdir(parents=True, exist_ok=True)
    (out / REPORT).write_text(text, encoding='utf-8')
    if failed := totals(outcomes)['failed']:
        raise HoidError(f'{failed} of {len(outcomes)} cases failed, see {out / REPORT}')
    return text


def _outcomes(seed: int, size: Size, kinds: Sequence[str]) -> Iterator[Outcome]:
    seeds = {
        kind: range(seed, seed + number)
        for kind, number in vars(size).items()
        if kind in kinds and number
    }
    with tempfile.TemporaryDirectory(prefix='hoid faults ') as scratch:
        folder = Path(scratch)
        samples = make_samples(folder / 'samples')
        if found := seeds.get(FILES):
            cases = file_cases(samples, folder / FILES, found)
            yield from progress(cases, len(found) * len(KINDS), FILES, show=True)
        if found := seeds.get(KILLS):
            cases = kill_cases(samples, folder / KILLS, found)
            yield from progress(cases, len(found) * len((CONVERT, RECORD)), KILLS, show=True)
        yield from _live_outcomes(samples, folder, seeds)


def _live_outcomes(samples: Samples, folder: Path, seeds: dict[str, range]) -> Iterator[Outcome]:
    """Yield the outcomes of running nodes; they come last, because the other cases fork.

    A process with threads, such as those of ROS, must not fork.
    """
    # These modules need ROS.
    from hoid_benchmarks.faults.live.cameras import camera_cases  # noqa: PLC0415
    from hoid_benchmarks.faults.live.commands import command_cases  # noqa: PLC0415
    from hoid_benchmarks.faults.live.deaths import death_cases  # noqa: PLC0415
    from hoid_benchmarks.faults.live.shared_nodes import shared_node_cases  # noqa: PLC0415
    from hoid_benchmarks.faults.live.soak import soak_cases  # noqa: PLC0415
    from hoid_benchmarks.faults.live.two_hosts.network import network_cases  # noqa: PLC0415

    if found := seeds.get(NETWORK):
        yield from network_cases(folder / NETWORK, found)
    messages, conditions = (seeds.get(kind, range(0)) for kind in (MESSAGES, CONDITIONS))
    if messages or conditions:
        yield from shared_node_cases(samples, folder, messages, conditions)
    if found := seeds.get(COMMANDS):
        yield from command_cases(folder / COMMANDS, found)
    if found := seeds.get(CAMERAS):
        yield from camera_cases(folder / CAMERAS, found)
    if found := seeds.get(DEATHS):
        yield from death_cases(folder / DEATHS, found)
    if found := seeds.get(SOAK):
        yield from soak_cases(folder / SOAK, len(found))
