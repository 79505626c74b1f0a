"""The suite as a user starts it, with its output in a file or in a pipe that nobody reads."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil

from hoid_system_tests.probe import Probe

HOID = (sys.executable, '-m', 'hoid_bringup')
LIMIT_S = 60.0
_END_S = 30.0


class StartedSuite:
    """A command in a process group of its own, and the nodes that it has started.

    Args:
        argv: The command.
        log: File for its stdout and stderr.
    """

    def __init__(self, argv: Sequence[str], log: Path) -> None:
        self.log = log
        with log.open('ab') as file:
            self.process = subprocess.Popen(
                argv, stdout=file, stderr=subprocess.STDOUT, process_group=0
            )

    def pid_of(self, package: str) -> int | None:
        """Return the process id of a node; None while it does not run."""
        for child in psutil.Process(self.process.pid).children(recursive=True):
            try:
                is_node = child.parent().pid == self.process.pid and any(
                    f"start('{package}.node')" in word or Path(word).name == f'{package}_node'
                    for word in child.cmdline()
                )
            except (psutil.Error, AttributeError):  # it has just ended
                continue
            if is_node:
                return int(child.pid)
        return None

    def kill(self, package: str) -> None:
        """Kill a node."""
        pid = self.pid_of(package)
        assert pid is not None
        os.kill(pid, signal.SIGKILL)

    def await_line(self, probe: Probe, text: str, count: int = 1) -> str:
        """Wait until a number of lines of output contain a text, and return the last one."""

        def lines() -> list[str]:
            return [line for line in self.log.read_text().splitlines() if text in line]

        probe.spin_until(lambda: len(lines()) >= count, f'the output lacks "{text}"', LIMIT_S)
        return lines()[-1]

    def await_end(self) -> int:
        """Wait until the command has ended, and return its status."""
        return self.process.wait(_END_S)

    def end(self) -> None:
        """End the command with its nodes; those that do not end in time are killed."""
        if self.process.poll() is not None:
            return
        nodes = psutil.Process(self.process.pid).children(recursive=True)
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(_END_S)
        finally:
            _, late = psutil.wait_procs(nodes, timeout=0)
            for process in late:
                process.kill()
            self.process.kill()


@contextmanager
def started_suite(argv: Sequence[str], log: Path) -> Iterator[StartedSuite]:
    """Run a command, and end it and its nodes when the block is left."""
    suite = StartedSuite(argv, log)
    try:
        yield suite
    finally:
        suite.end()
