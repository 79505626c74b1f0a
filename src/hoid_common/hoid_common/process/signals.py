"""How a command is asked to end: by Ctrl-C, by a supervisor, or by closing its terminal."""

from __future__ import annotations

import os
import signal
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import current_thread, main_thread
from types import FrameType

ENDING = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""What asks a process to end as SIGINT does."""


def end_as_by_interrupt() -> None:
    """Have SIGTERM, SIGHUP and SIGQUIT raise KeyboardInterrupt, the first of them only.

    Whoever asked has been heard then, and a shell that closes says it twice. What the process was
    started to ignore, as by `nohup`, it goes on ignoring.
    """
    for sign in ENDING:
        if signal.getsignal(sign) is not signal.SIG_IGN:
            signal.signal(sign, _interrupt)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let signals to end wait until the block is done; for what must not stay half done."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *ENDING})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def handlers_deferred() -> Iterator[None]:
    """Let Python's handlers of signals to end wait until the block is done, in the main thread.

    Blocking the signals in this thread is not enough: another one, as of a library, takes them,
    and Python runs the handler here.
    """
    came: list[int] = []
    before = {}
    if current_thread() is main_thread():  # no other may set handlers, and none interrupts others
        before = {sign: signal.getsignal(sign) for sign in (signal.SIGINT, *ENDING)}
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
    for sign in ENDING:
        signal.signal(sign, signal.SIG_IGN)
    if number == signal.SIGHUP:
        _leave_terminal()
    raise KeyboardInterrupt


def _leave_terminal() -> None:
    """Write to nowhere from now on: the terminal is gone, and writing to it would fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        with suppress(OSError):
            if stat.S_ISCHR(os.fstat(descriptor).st_mode):
                os.dup2(nowhere, descriptor)
    os.close(nowhere)
