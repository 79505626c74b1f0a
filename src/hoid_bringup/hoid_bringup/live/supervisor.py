"""Child processes that start together, are watched, and always end: SIGINT, SIGTERM, then SIGKILL.

A ROS node can hang while it shuts down with the interpreter lock held, so that nothing inside it
can end it; therefore the escalation.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import psutil

from hoid_common.io.files import write_error
from hoid_common.process.entry import EXIT_CONFIG

_LOG = logging.getLogger(__name__)

_GRACE_S = 10.0  # a node ends itself after that, and `ros2 launch` waits as long before it kills
_POLL_S = 0.02
_MEMORY_PERIOD_S = 2.0  # a look goes through all processes of the machine
RESTART_PERIOD_S = 1.0
_BYTES_PER_MB = 2**20


@dataclass(frozen=True)
class ProcessSpec:
    """One child: its name for people and its command line."""

    name: str
    argv: tuple[str, ...]
    env: Mapping[str, str] = field(default_factory=dict)  # on top of this process's own


@dataclass(frozen=True)
class ProcessExit:
    """A child that ended though nobody asked it to."""

    name: str
    status: int  # exit status; negative: the signal

    @property
    def was_refusal(self) -> bool:
        """Return whether it would end the same way if it were started again."""
        return self.status == EXIT_CONFIG

    def __str__(self) -> str:
        if self.was_refusal:
            return f'{self.name} refused to start'
        how = f'signal {signal.Signals(-self.status).name}' if self.status < 0 else ''
        return f'{self.name} ended ({how or f"status {self.status}"})'


class Supervisor:
    """Runs children in process groups of their own; use as a context manager.

    Args:
        specs: What to start.
        restart: Start a dead child anew instead of leaving it dead, unless it refused to start.
        restart_period_s: The least time from one start of a child to the next.
        log_dir: Folder that gets one file of output per child; None lets them write here.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        *,
        restart: bool = False,
        restart_period_s: float = RESTART_PERIOD_S,
        log_dir: Path | None = None,
    ) -> None:
        self._specs = {spec.name: spec for spec in specs}
        self._restart = restart
        self._restart_period_s = restart_period_s
        self._log_dir = log_dir
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._started_s: dict[str, float] = {}  # monotonic
        self._due_s: dict[str, float] = {}  # when a dead child starts anew
        self._peak_rss_mb: dict[str, float] = {}
        self._next_look_s = 0.0  # when to look at the memory next

    def __enter__(self) -> Self:
        try:
            for spec in self._specs.values():
                self._start(spec)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def pids(self) -> dict[str, int]:
        """Return the process ids of the children that run, by name."""
        return {name: process.pid for name, process in self._running.items()}

    def peak_rss_mb(self) -> dict[str, float]:
        """Return the highest resident memory that `poll` saw of each child and its children."""
        return dict(self._peak_rss_mb)

    def cpu_s(self) -> dict[str, float]:
        """Return the processor time that each child that runs has taken, with its children."""
        return {
            name: sum(_of_family(process.pid, _busy_s)) for name, process in self._running.items()
        }

    def poll(self) -> list[ProcessExit]:
        """Return the children that ended since the last call; restart them if so told."""
        now_s = time.monotonic()
        if now_s >= self._next_look_s:
            self._next_look_s = now_s + _MEMORY_PERIOD_S
            for name, process in self._running.items():
                seen_mb = family_mb(process.pid)
                self._peak_rss_mb[name] = max(self._peak_rss_mb.get(name, 0.0), seen_mb)
        exits = []
        for name, process in list(self._running.items()):
            status = process.poll()
            if status is None:
                continue
            del self._running[name]
            exits.append(ProcessExit(name, status))
            if self._restart and not exits[-1].was_refusal:
                self._due_s[name] = self._started_s[name] + self._restart_period_s
        for name, due_s in list(self._due_s.items()):
            if now_s >= due_s:
                del self._due_s[name]
                self._start(self._specs[name])
        return exits

    def stop(self, grace_s: float = _GRACE_S) -> None:
        """End all children, politely first, and return when all are gone."""
        self._due_s.clear()
        for sign, wait_s in (
            (signal.SIGINT, grace_s),
            (signal.SIGTERM, grace_s / 4),
            (signal.SIGKILL, grace_s),
        ):
            if not self._running:
                return
            self._signal_all(sign)
            self._wait(wait_s)
            if self._running and sign is signal.SIGTERM:
                _LOG.warning('%s did not end; killed', ', '.join(self._running))

    def _start(self, spec: ProcessSpec) -> None:
        output = None
        if self._log_dir is not None:
            try:
                self._log_dir.mkdir(parents=True, exist_ok=True)
                output = (self._log_dir / f'{spec.name}.log').open('ab')
            except OSError as error:
                raise write_error(self._log_dir, error) from error
        with contextlib.ExitStack() as stack:
            if output is not None:
                stack.enter_context(output)  # the child keeps its own copy of the descriptor
            self._started_s[spec.name] = time.monotonic()
            self._running[spec.name] = subprocess.Popen(
                (*_ending_with_parent(), *spec.argv),
                env={**os.environ, **spec.env},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT if output is not None else None,
                # Ctrl-C reaches us alone; we pass it on in order. All stay in one session, for
                # Linux weighs niceness within one only (sched(7), autogroup).
                process_group=0,
            )

    def _signal_all(self, sign: signal.Signals) -> None:
        for process in self._running.values():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, sign)

    def _wait(self, timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s
        while self._running and time.monotonic() < deadline_s:
            for name, process in list(self._running.items()):
                if process.poll() is not None:
                    del self._running[name]
            time.sleep(_POLL_S)


def family_mb(pid: int) -> float:
    """Return the resident memory of a process and of all that it has started, in MB."""
    return sum(_of_family(pid, _memory_mb))


def _memory_mb(process: psutil.Process) -> float:
    return float(process.memory_info().rss / _BYTES_PER_MB)


def _busy_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _of_family(pid: int, measure: Callable[[psutil.Process], float]) -> Iterator[float]:
    """Yield a measure of a process and of all that it has started, but for those that ended."""
    with contextlib.suppress(psutil.NoSuchProcess):
        process = psutil.Process(pid)
        for member in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess):
                yield measure(member)


def _ending_with_parent() -> tuple[str, ...]:
    """Return what to put before a command so that it ends when this process is killed."""
    tool = shutil.which('setpriv')  # of util-linux
    return (tool, '--pdeathsig', 'TERM', '--') if tool is not None else ()
