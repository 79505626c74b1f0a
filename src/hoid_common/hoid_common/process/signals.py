"""Handling of the signals that end a command: Ctrl-C, SIGTERM, a closed terminal."""

from __future__ import annotations

import os
import signal
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from threading import current_thread, main_thread
from types import FrameType

TERMINATION_SIGNALS = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""The signals, beside SIGINT, that ask a process to end."""
FAILURE_SIGNAL = signal.SIGUSR1
"""Signal that ends a node because another process failed: its map is kept (decision 046)."""
NODE_END_SIGNALS = (signal.SIGINT, *TERMINATION_SIGNALS, FAILURE_SIGNAL)
"""The signals that a node handles by ending in order."""


def interrupt_on_termination() -> None:
    """Make the first SIGTERM, SIGHUP or SIGQUIT raise KeyboardInterrupt; ignore later ones.

    Later signals must not interrupt the clean-up: a closing shell sends SIGHUP twice. Signals that
    were ignored before, as with `nohup`, stay ignored.
    """
    for sign in TERMINATION_SIGNALS:
        if signal.getsignal(sign) is not signal.SIG_IGN:
            signal.signal(sign, _interrupt)


def termination_signals_blocked() -> AbstractContextManager[None]:
    return signals_blocked(signal.SIGINT, *TERMINATION_SIGNALS)


@contextmanager
def signals_blocked(*signals: signal.Signals) -> Iterator[None]:
    """Block signals in this thread within the block; a process started there inherits the mask."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def signal_handlers_deferred() -> Iterator[None]:
    """Defer the Python handlers of SIGINT and the termination signals to the end of the block.

    Blocking the signals in this thread is not enough: the kernel delivers them to another thread,
    and Python then runs the handlers in the main thread nevertheless.
    """
    came: list[int] = []
    before = {}
    if current_thread() is main_thread():  # only it may set handlers, and only it runs them
        before = {sign: signal.getsignal(sign) for sign in (signal.SIGINT, *TERMINATION_SIGNALS)}
        before = {sign: handler for sign, handler in before.items() if callable(handler)}
    for sign in before:
        signal.signal(sign, lambda number, _frame: came.append(number))
    try:
        yield
    finally:
        for sign, handler in before.items():
            signal.signal(sign, handler)
        for number in came:
            signal.raise_signal(number)


def _interrupt(number: int, _frame: FrameType | None) -> None:
    for sign in TERMINATION_SIGNALS:
        signal.signal(sign, signal.SIG_IGN)
    if number == signal.SIGHUP:
        _leave_terminal()
    raise KeyboardInterrupt


def _leave_terminal() -> None:
    """Redirect stdout and stderr to /dev/null if they lead to a terminal, which is closed now."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        with suppress(OSError):
            if stat.S_ISCHR(os.fstat(descriptor).st_mode):
                os.dup2(nowhere, descriptor)
    os.close(nowhere)
