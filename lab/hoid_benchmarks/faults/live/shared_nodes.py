"""Fault cases that share running nodes, because starting nodes takes longer than most cases."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.conditions import (
    calibration_cases,
    clock_cases,
    load_cases,
    sim_time_cases,
)
from hoid_benchmarks.faults.live.disks.disk import disk_cases
from hoid_benchmarks.faults.live.disks.slow_disk import slow_disk_cases
from hoid_benchmarks.faults.live.inputs import message_cases
from hoid_benchmarks.faults.live.node_harness import Setup, running_nodes
from hoid_benchmarks.faults.samples import Samples
from hoid_bringup.live.node_specs import FILTER, SLAM


def shared_node_cases(
    samples: Samples, folder: Path, messages: range, conditions: range
) -> Iterator[Outcome]:
    """Yield the outcomes of wrong messages, clocks, loads and disks."""
    with running_nodes(folder / 'raw', Setup()) as harness:
        yield from message_cases(harness, messages)
        yield from clock_cases(harness, conditions)
        yield from load_cases(harness, conditions)
        yield from calibration_cases(harness, conditions)
        if conditions:
            yield from disk_cases(harness, partial(_writers, samples), conditions)
    if conditions:
        yield from slow_disk_cases(folder / 'slow disk', conditions)
    if messages:
        foreign = Setup((FILTER, SLAM), sim_time=True, is_foreign=True)
        for name, setup in (('packed', Setup(is_compressed=True)), ('foreign', foreign)):
            with running_nodes(folder / name, setup) as harness:
                yield from message_cases(harness, messages)
    if len(conditions) > 1:
        yield from sim_time_cases(folder / 'sim time', conditions)


def _writers(samples: Samples, bag: Path) -> tuple[tuple[str, ...], ...]:
    """Return the commands that write a bag to a path."""
    hoid = (sys.executable, '-m', 'hoid_bringup')
    convert = ('convert', str(samples.tum), str(bag), '--calibration', str(samples.camera))
    return (*hoid, *convert), (*hoid, 'record', str(bag))
