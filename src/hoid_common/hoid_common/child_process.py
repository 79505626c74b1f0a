"""Processes that work for the tracker and end with it."""

from __future__ import annotations

import signal
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess


def start_child(process: BaseProcess) -> None:
    """Start a process that never hears SIGINT, not even while it still imports.

    Ctrl-C reaches all processes of a terminal, but who started this one ends it, in its own time.
    The signal is blocked rather than ignored, as a process inherits that.
    """
    resource_tracker.ensure_running()  # which would unblock the signal if it were started below
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
