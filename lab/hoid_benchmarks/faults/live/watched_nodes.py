"""Nodes supervised by another process, as on a robot.

A process that publishes to a killed node can block for seconds in the middleware while it holds
the interpreter lock. A supervisor in the same process would restart the node that much later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from hoid_bringup.live.supervisor import ProcessExit, ProcessSpec, Supervisor
from hoid_common.process.child_process import ChildWorker

_PERIOD_S = 0.02
_START_S = 30.0
_PATIENCE_S = 30.0  # longer than the supervisor waits before it sends SIGKILL


class _Change(NamedTuple):
    pids: dict[str, int]
    exits: list[ProcessExit]


class WatchedNodes:
    """Nodes under a `Supervisor` in another process, with the same interface."""

    def __init__(self, worker: ChildWorker[None, _Change]) -> None:
        self._worker = worker
        self._pids, self._exits = worker.receive(_START_S)

    @property
    def pids(self) -> dict[str, int]:
        """Return the process ids of the nodes that ran at the last `poll`, by name."""
        return dict(self._pids)

    def poll(self) -> list[ProcessExit]:
        """Return the nodes that ended since the last call."""
        while self._worker.has_report:
            self._pids, exits = self._worker.receive(0.0)
            self._exits += exits
        ended, self._exits = self._exits, []
        return ended


@contextmanager
def watched(
    specs: Sequence[ProcessSpec], *, restart: bool, log_dir: Path
) -> Iterator[WatchedNodes]:
    """Run nodes, and end them when the block is left.

    Args:
        specs: The processes to start.
        restart: Whether to restart a node that has ended.
        log_dir: Folder of the log files, one for each node.
    """
    worker: ChildWorker[None, _Change] = ChildWorker('supervisor', _watch, specs, restart, log_dir)
    try:
        yield WatchedNodes(worker)
    finally:
        worker.close(_PATIENCE_S)


def _watch(
    messages: Connection, changes: Connection, specs: Sequence[ProcessSpec], restart: bool,
    log_dir: Path,
) -> None:  # fmt: skip
    """Supervise the nodes until the parent closes the pipe; main function of the process."""
    with Supervisor(specs, restart=restart, log_dir=log_dir) as nodes:
        reported = _Change(nodes.pids, [])
        changes.send(reported)
        while not messages.poll(_PERIOD_S):
            exits = nodes.poll()
            if exits or nodes.pids != reported.pids:
                reported = _Change(nodes.pids, exits)
                changes.send(reported)
