"""A disk that takes its time, by a library that is preloaded into the nodes: no root is needed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.disks.disk import SLOW, Saves, run_command
from hoid_benchmarks.faults.live.stage import MAPS, Seen, Setup, shared, staged

_SOURCE = Path(__file__).with_name('slow_disk.cpp')
_LEAST_SHARE = 0.9  # of the images that odometry must come of


def slow_disk_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of all files asked for while each write takes 20 ms, a sync 0.5 s."""
    folder.mkdir(parents=True)
    library, sign, nodes = folder / 'slow_disk.so', folder / 'slow', folder / 'nodes'
    if refused := run_command('c++', '-shared', '-fPIC', '-o', library, _SOURCE, '-ldl'):
        yield Outcome(SLOW, seeds.start, '', skipped=refused)
        return
    environment = {
        'LD_PRELOAD': library.name,  # a path must not have spaces there; found by the next line
        'LD_LIBRARY_PATH': f'{folder}:{os.environ.get("LD_LIBRARY_PATH", "")}',
        'HOID_SLOW_DISK': str(nodes / MAPS),
        'HOID_SLOW_WHILE': str(sign),
    }
    with staged(nodes, Setup(environment=environment)) as stage:
        saves = Saves(stage)

        def trouble() -> Seen:
            first = len(stage.sender.sent)
            sign.touch()
            complaint = saves.complaint(are_done=True)
            if not complaint and not sign.stat().st_size:  # the library writes there
                complaint = 'nothing was slow'
            sign.unlink()
            seen = shared(stage.sender.share_since(first), _LEAST_SHARE)
            return seen._replace(complaint=complaint or seen.complaint)

        if complaint := saves.first_complaint():
            yield Outcome(SLOW, seeds.start, f'on a good disk: {complaint}')
            return
        for seed in seeds:
            yield stage.outcome(SLOW, seed, trouble)
