"""Cases that share nodes: to start them takes longer than most of these cases."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.conditions import clock_cases, load_cases, sim_time_cases
from hoid_benchmarks.faults.live.disks.disk import disk_cases
from hoid_benchmarks.faults.live.disks.slow_disk import slow_disk_cases
from hoid_benchmarks.faults.live.inputs import message_cases
from hoid_benchmarks.faults.live.stage import Setup, staged
from hoid_benchmarks.faults.samples import Samples
from hoid_bringup.live.node_specs import FILTER, SLAM


def standing_cases(
    samples: Samples, folder: Path, messages: range, conditions: range
) -> Iterator[Outcome]:
    """Yield the outcomes of wrong messages and of bad conditions."""
    with staged(folder / 'raw', Setup()) as stage:
        yield from message_cases(stage, messages)
        yield from clock_cases(stage, conditions)
        yield from load_cases(stage, conditions)
        if conditions:
            yield from disk_cases(stage, partial(_writers, samples), conditions)
    if conditions:
        yield from slow_disk_cases(folder / 'slow disk', conditions)
    if messages:
        foreign = Setup((FILTER, SLAM), has_scene=False, sim_time=True, is_foreign=True)
        for name, setup in (('packed', Setup(is_compressed=True)), ('foreign', foreign)):
            with staged(folder / name, setup) as stage:
                yield from message_cases(stage, messages)
    if len(conditions) > 1:
        yield from sim_time_cases(folder / 'sim time', conditions)


def _writers(samples: Samples, bag: Path) -> tuple[tuple[str, ...], ...]:
    """Return the commands that write a bag."""
    hoid = (sys.executable, '-m', 'hoid_bringup')
    convert = ('convert', str(samples.tum), str(bag), '--camera', str(samples.camera))
    return (*hoid, *convert), (*hoid, 'record', str(bag))
