"""What processes use: processor time, memory and wake-ups, as the kernel counts them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import psutil

_BYTES_PER_MB = 2**20
_WAKE_UPS = 'voluntary_ctxt_switches:'


class Usage(NamedTuple):
    """What a process uses while it runs."""

    cpu: float  # processor seconds per second
    pss_mb: float  # proportional set size: shared pages are divided among their users
    wake_ups_hz: float  # voluntary context switches of all threads


class _Counters(NamedTuple):
    cpu_s: float
    wake_ups: dict[int, int]  # by thread


class UsageMeter:
    """Measures processes from its construction to `read`.

    Args:
        pids: Process ids by name.
    """

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = dict(pids)
        self._start_s = time.monotonic()
        self._before = {name: _counters(pid) for name, pid in self._pids.items()}

    def read(self) -> dict[str, Usage]:
        """Return the usage of each process that still runs, by name."""
        elapsed_s = time.monotonic() - self._start_s
        found: dict[str, Usage] = {}
        for name, pid in self._pids.items():
            with suppress(psutil.NoSuchProcess, FileNotFoundError):
                before, after = self._before[name], _counters(pid)
                woken = sum(n - before.wake_ups.get(t, 0) for t, n in after.wake_ups.items())
                pss_mb = psutil.Process(pid).memory_full_info().pss / _BYTES_PER_MB
                cpu = (after.cpu_s - before.cpu_s) / elapsed_s
                found[name] = Usage(cpu, pss_mb, woken / elapsed_s)
        return found


def _counters(pid: int) -> _Counters:
    times = psutil.Process(pid).cpu_times()
    wake_ups: dict[int, int] = {}
    for thread in Path(f'/proc/{pid}/task').iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # the thread has ended
            for line in (thread / 'status').read_text().splitlines():
                if line.startswith(_WAKE_UPS):
                    wake_ups[int(thread.name)] = int(line.removeprefix(_WAKE_UPS))
    return _Counters(times.user + times.system, wake_ups)
