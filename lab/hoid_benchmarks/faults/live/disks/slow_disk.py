"""A slow disk, simulated by a library that is preloaded into the nodes, without root rights."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.disks.disk import SLOW, SaveChecks, run_command
from hoid_benchmarks.faults.live.node_harness import (
    MAPS,
    CaseResult,
    Setup,
    odometry_result,
    running_nodes,
)

_SOURCE = Path(__file__).with_name('slow_disk.cpp')
_LEAST_SHARE = 0.9  # of images with odometry


def slow_disk_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of saving all files while a write takes 20 ms and a sync 0.5 s."""
    folder.mkdir(parents=True)
    library, sign, nodes = folder / 'slow_disk.so', folder / 'slow', folder / 'nodes'
    if refused := run_command('c++', '-shared', '-fPIC', '-o', library, _SOURCE, '-ldl'):
        yield Outcome(SLOW, seeds.start, '', skipped=refused)
        return
    environment = {
        'LD_PRELOAD': library.name,  # without its folder, whose name contains spaces
        'LD_LIBRARY_PATH': f'{folder}:{os.environ.get("LD_LIBRARY_PATH", "")}',
        'HOID_SLOW_DISK': str(nodes / MAPS),
        'HOID_SLOW_WHILE': str(sign),
    }
    with running_nodes(nodes, Setup(environment=environment)) as harness:
        saves = SaveChecks(harness)

        def trouble() -> CaseResult:
            first = len(harness.sender.sent)
            sign.touch()
            complaint = saves.complaint(are_done=True)
            # The library writes a byte for each delayed call.
            if not complaint and not sign.stat().st_size:
                complaint = 'nothing was slow'
            sign.unlink()
            result = odometry_result(harness.sender.share_since(first), _LEAST_SHARE)
            return result._replace(complaint=complaint or result.complaint)

        if complaint := saves.first_complaint():
            yield Outcome(SLOW, seeds.start, f'on a good disk: {complaint}')
            return
        for seed in seeds:
            yield harness.outcome(SLOW, seed, trouble)
