"""Supervision of child processes, which are started and ended together.

A ROS node can hang in its shutdown while it holds Python's interpreter lock, so that it cannot end
itself. The supervisor therefore sends SIGINT, then SIGTERM, then SIGKILL.

If the supervisor's block ends by an error, the children get their failure signal instead of
SIGINT: the SLAM node then keeps its checkpoint (decision 046).

`ros2 launch` does the same with `respawn`, but needs an installation of ROS; `hoid` does not.
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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Self

import psutil

from hoid_common.errors import InputError
from hoid_common.io.files import written
from hoid_common.process.entry import EXIT_CONFIG

_LOG = logging.getLogger(__name__)

# Time in which a node must end itself after SIGINT. Then it gets SIGTERM, and SIGKILL a little
# later. `ros2 launch` waits as long before it sends SIGKILL.
_GRACE_S = 10.0
# Chosen: period of the measurement, which reads all processes of the machine.
_MEMORY_PERIOD_S = 2.0
RESTART_PERIOD_S = 1.0  # chosen: a node that fails at once then does not keep a whole core busy
# Chosen: longest time between two starts of a child that refuses to start, because each start
# takes a core for about a second.
_MAX_REFUSAL_PERIOD_S = 30.0
_BYTES_PER_MB = 2**20


@dataclass(frozen=True)
class ProcessSpec:
    """Command line and environment of a child process, and the signal that ends it."""

    name: str
    argv: tuple[str, ...]
    # Added to the environment of this process.
    env: Mapping[str, str] = field(default_factory=dict)
    # Signal that ends the child after a failure of another child or of the supervising process.
    failure_signal: signal.Signals = signal.SIGTERM


@dataclass(frozen=True)
class ProcessExit:
    """The end of a child process that the supervisor has not caused."""

    name: str
    status: int  # exit status; if negative, the signal that ended the child
    restart_s: float | None = None  # time until it is restarted; None: no restart

    @property
    def refused_to_start(self) -> bool:
        """Return whether the child rejected its configuration, or a file that it needs."""
        return self.status == EXIT_CONFIG

    def __str__(self) -> str:
        if self.refused_to_start:
            return f'{self.name} refused to start'
        how = f'signal {signal.Signals(-self.status).name}' if self.status < 0 else ''
        return f'{self.name} ended ({how or f"status {self.status}"})'


class Supervisor:
    """Context manager that starts child processes and ends them at the end of the block.

    Call `poll` regularly: it finds children that have ended, restarts them if this is configured,
    and measures memory.

    Args:
        restart: Whether to restart a child that ended, unless it refused its first start. A child
            that refuses a later start has worked before with the same options, so that probably a
            file is damaged or missing at present: it is tried again after growing pauses.
        restart_period_s: Minimum time between two starts of a child.
        log_dir: Folder for one log file per child; None lets the children write to the terminal.
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
        self._due_s: dict[str, float] = {}  # by child: time of the next restart (monotonic)
        self._started_s: dict[str, float] = {}  # by child: time of the last start (monotonic)
        # By child: pause after the next refusal, which doubles each time.
        self._pauses_s: dict[str, float] = {}
        self._has_run: set[str] = set()  # children that have started successfully
        self._peak_rss_mb: dict[str, float] = {}
        # By child: number of bytes of its log file that have been read.
        self._read_bytes: dict[str, int] = {}
        self._next_measurement_s = 0.0  # time of the next measurement (monotonic)

    def __enter__(self) -> Self:
        try:
            for spec in self._specs.values():
                self._start(spec)
        except BaseException:
            self.stop(after_failure=True)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.stop(after_failure=kind is not None and kind is not KeyboardInterrupt)

    @property
    def pids(self) -> dict[str, int]:
        return {name: process.pid for name, process in self._running.items()}

    def peak_rss_mb(self) -> dict[str, float]:
        """Return the peak resident memory (MiB) of each child, with its descendants."""
        return dict(self._peak_rss_mb)

    def new_log_lines(self) -> list[str]:
        """Return the lines that the children have written to log files since the last call."""
        lines: list[str] = []
        for name, first in self._read_bytes.items():
            with contextlib.suppress(OSError), self._log_path(name).open('rb') as log:
                log.seek(first)
                complete, end, _ = log.read().rpartition(b'\n')
                self._read_bytes[name] += len(complete + end)
                lines += complete.decode(errors='replace').splitlines()
        return lines

    def cpu_s(self) -> dict[str, float]:
        """Return the processor time (s) of each running child, with its descendants."""
        return {name: sum(_of_family(pid, _cpu_s)) for name, pid in self.pids.items()}

    def poll(self) -> list[ProcessExit]:
        """Return the children that have ended by themselves since the last call.

        It restarts children if this is configured and their last start is long enough ago, and
        measures their memory every two seconds.
        """
        now_s = time.monotonic()
        if now_s >= self._next_measurement_s:
            self._next_measurement_s = now_s + _MEMORY_PERIOD_S
            for name, pid in self.pids.items():
                self._peak_rss_mb[name] = max(self._peak_rss_mb.get(name, 0.0), family_mb(pid))
        exits = [
            self._exit(name, status, now_s)
            for name, process in list(self._running.items())
            if (status := process.poll()) is not None
        ]
        for name in sorted(self._due_s):
            if now_s >= self._due_s[name]:
                self._restart_child(name, now_s)
        return exits

    def stop(self, grace_s: float = _GRACE_S, *, after_failure: bool = False) -> None:
        """End all children by SIGINT, then SIGTERM, then SIGKILL, and wait until they have ended.

        Restarts that were due are cancelled. SIGTERM follows after `grace_s`, SIGKILL after
        another quarter of it. After a failure, each child gets its failure signal in place of
        SIGINT.
        """
        self._due_s.clear()
        if after_failure:
            for name, process in self._running.items():
                # Sent to the child only and not to its process group, because its own children do
                # not handle this signal.
                process.send_signal(self._specs[name].failure_signal)
        else:
            self._signal_all(signal.SIGINT)
        self._wait(grace_s)
        for sign, wait_s in ((signal.SIGTERM, grace_s / 4), (signal.SIGKILL, grace_s)):
            self._signal_all(sign)
            self._wait(wait_s)
            if self._running and sign is signal.SIGTERM:
                _LOG.warning(
                    '%s did not end after SIGTERM; sending SIGKILL', ', '.join(self._running)
                )

    def _exit(self, name: str, status: int, now_s: float) -> ProcessExit:
        del self._running[name]
        ended = ProcessExit(name, status)
        if not ended.refused_to_start:
            self._has_run.add(name)
            self._pauses_s.pop(name, None)
        if not self._restart or name not in self._has_run:
            return ended
        pause_s = max(self._started_s[name] + self._restart_period_s - now_s, 0.0)
        if ended.refused_to_start:
            pause_s = self._next_pause_s(name)
        self._due_s[name] = now_s + pause_s
        return replace(ended, restart_s=pause_s)

    def _next_pause_s(self, name: str) -> float:
        """Return the pause (s) before the next start of a child, and double it, up to 30 s."""
        pause_s = self._pauses_s.get(name, self._restart_period_s)
        self._pauses_s[name] = min(2 * pause_s, _MAX_REFUSAL_PERIOD_S)
        return pause_s

    def _restart_child(self, name: str, now_s: float) -> None:
        """Restart a child; if the system refuses, as with a full disk, schedule another try."""
        del self._due_s[name]
        try:
            self._start(self._specs[name])
        except (OSError, InputError) as error:
            pause_s = self._next_pause_s(name)
            self._due_s[name] = now_s + pause_s
            _LOG.warning('%s cannot be started (%s); trying again in %.0f s', name, error, pause_s)

    def _start(self, spec: ProcessSpec) -> None:
        with self._log_file(spec.name) as log:
            self._started_s[spec.name] = time.monotonic()
            self._running[spec.name] = subprocess.Popen(
                (*_end_with_parent(spec.failure_signal), *spec.argv),
                env={**os.environ, **spec.env},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT if log is not None else None,
                # In process groups of their own, the children do not receive Ctrl-C. They share
                # one session, because niceness counts only within a session (sched(7), autogroup).
                process_group=0,
            )

    def _log_file(self, name: str) -> contextlib.AbstractContextManager[IO[bytes] | None]:
        if self._log_dir is None:
            return contextlib.nullcontext()
        with written(self._log_dir):
            self._log_dir.mkdir(parents=True, exist_ok=True)
            log = self._log_path(name).open('ab')
            self._read_bytes.setdefault(name, log.tell())
            return log

    def _log_path(self, name: str) -> Path:
        return (self._log_dir or Path()) / f'{name}.log'

    def _signal_all(self, sign: signal.Signals) -> None:
        for pid in self.pids.values():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, sign)

    def _wait(self, timeout_s: float) -> None:
        end_s = time.monotonic() + timeout_s
        for name, process in list(self._running.items()):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(end_s - time.monotonic(), 0.0))
                del self._running[name]


def family_mb(pid: int) -> float:
    """Return the resident memory of a process and its descendants in MiB."""
    return sum(_of_family(pid, _rss_mb))


def last_line(log: Path) -> str:
    """Return the last line of a log file, without "error: ", or why there is none."""
    try:
        lines = log.read_text(encoding='utf-8', errors='replace').split('\n')
    except OSError as error:
        return f'its log file {log} cannot be read: {error.strerror}'
    lines = [line.strip() for line in lines if line.strip()]
    return lines[-1].removeprefix('error: ') if lines else f'its log file {log} is empty'


def _rss_mb(process: psutil.Process) -> float:
    return float(process.memory_info().rss / _BYTES_PER_MB)


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _of_family(pid: int, measure: Callable[[psutil.Process], float]) -> Iterator[float]:
    """Yield a measurement of a process and of each descendant that still runs."""
    with contextlib.suppress(psutil.NoSuchProcess):
        process = psutil.Process(pid)
        for member in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess):
                yield measure(member)


def _end_with_parent(sign: signal.Signals) -> tuple[str, ...]:
    """Return the command prefix (setpriv) by which a child gets a signal when this process dies.

    The prefix is empty if the program setpriv (of util-linux) is missing.
    """
    setpriv = shutil.which('setpriv')
    return (setpriv, '--pdeathsig', sign.name, '--') if setpriv is not None else ()
