"""Functions that run in a child process, which may crash, hang or be killed."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from threading import RLock
from typing import NamedTuple

from tqdm import tqdm

_POLL_S = 0.002
_KIB_PER_MB = 1024
_RAISED = 99  # exit status of a child whose function raised an exception


class Ended(NamedTuple):
    """How a child process ended."""

    status: int  # exit status; the negative signal number if a signal ended it
    stderr: str
    wall_s: float
    peak_mb: float
    was_killed: bool  # by this process, at the time limit


def run_guarded(work: Callable[[], int], limit_s: float) -> Ended:
    """Run a function in a fork of this process, which must have no threads; return how it ended.

    Args:
        work: Returns the exit status. The traceback of an exception is written to stderr.
        limit_s: Time after which the child is killed.
    """
    with tempfile.TemporaryFile() as stderr:
        start_s = time.monotonic()
        pid = os.fork()
        if pid == 0:
            _run_child(work, stderr.fileno())
        was_killed, end_s = False, start_s + limit_s
        while True:
            done, status, usage = os.wait4(pid, os.WNOHANG)
            if done:
                break
            if time.monotonic() > end_s and not was_killed:
                os.kill(pid, signal.SIGKILL)
                was_killed = True
            time.sleep(_POLL_S)
        wall_s = time.monotonic() - start_s
        stderr.seek(0)
        text = stderr.read().decode(errors='replace')
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, text, wall_s, usage.ru_maxrss / _KIB_PER_MB, was_killed)


def _run_child(work: Callable[[], int], stderr: int) -> None:
    status = _RAISED
    try:
        # Forks share tqdm's lock: a child that is killed while it holds it blocks all others.
        tqdm.set_lock(RLock())
        os.dup2(stderr, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        status = work()
    except SystemExit as error:  # argparse
        status = error.code if isinstance(error.code, int) else 1
    except BaseException:  # noqa: BLE001 - the parent reports every kind of exception
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)
