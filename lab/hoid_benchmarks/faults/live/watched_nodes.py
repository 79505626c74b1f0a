"""Nodes that are watched by another process, as on a robot.

Whoever sends to a node that is killed may wait for seconds in the middleware, with the
interpreter lock held. It would be that late to start the node anew.
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
_PATIENCE_S = 30.0  # more than a supervisor's, which ends with SIGKILL


class _Change(NamedTuple):
    pids: dict[str, int]
    exits: list[ProcessExit]


class WatchedNodes:
    """Nodes that run in a process of their own, as a `Supervisor` does it."""

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
    """Run nodes, and end them.

    Args:
        specs: What to start.
        restart: Start a dead node anew.
        log_dir: Folder that gets one file of output per node.
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
    """Run the nodes until there can be no more messages; the main function of the process."""
    with Supervisor(specs, restart=restart, log_dir=log_dir) as nodes:
        said = _Change(nodes.pids, [])
        changes.send(said)
        while not messages.poll(_PERIOD_S):
            exits = nodes.poll()
            if exits or nodes.pids != said.pids:
                said = _Change(nodes.pids, exits)
                changes.send(said)
