"""Nodes that another process supervises, as in fault injection."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import psutil

from hoid_benchmarks.faults.live.watched_nodes import watched
from hoid_bringup.live.supervisor import ProcessExit, ProcessSpec

LIMIT_S = 60.0
# Like a node, the process ends on SIGINT once it is ready. Python's handler runs only between
# instructions, so that it would miss a signal just before the sleep.
CODE = (
    'import os, signal, time; signal.signal(signal.SIGINT, signal.SIG_DFL);'
    'signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT});'
    'print(os.environ["MESSAGE"], flush=True); time.sleep(60)'
)
SPEC = ProcessSpec('node', (sys.executable, '-c', CODE), env={'MESSAGE': 'ready'})


def test_a_killed_node_is_restarted_without_polling_and_ends_on_sigint(tmp_path: Path) -> None:
    log = tmp_path / 'node.log'
    with watched([SPEC], restart=True, log_dir=tmp_path) as nodes:
        first = nodes.pids['node']
        wait_for(log, 1)
        time.sleep(1.0)  # a process that ends sooner is not restarted immediately
        os.kill(first, signal.SIGKILL)
        wait_for(log, 2)
        assert nodes.poll() == [ProcessExit('node', -signal.SIGKILL, restart_s=0.0)]
        assert nodes.poll() == []
        second = nodes.pids['node']
        assert second != first
        start_s = time.monotonic()
    assert not psutil.pid_exists(second)
    assert time.monotonic() - start_s < 5.0  # half the time before SIGTERM


def wait_for(log: Path, times: int) -> None:
    deadline_s = time.monotonic() + LIMIT_S
    while not log.exists() or log.read_text().count('ready') < times:
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
