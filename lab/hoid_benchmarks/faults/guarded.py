"""Work in a child process that may crash, hang or be killed, and what can be told of it."""

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
_RAISED = 99


class Ended(NamedTuple):
    """How a child ended."""

    status: int  # negative: the signal
    said: str  # on stderr
    wall_s: float
    peak_mb: float
    was_late: bool  # it had to be killed


def run_guarded(work: Callable[[], int], limit_s: float) -> Ended:
    """Run a function in a fork of this process, which must have no threads, and see how it ends.

    Args:
        work: Returns the exit status; what it raises is written to stderr.
        limit_s: When it is killed.
    """
    with tempfile.TemporaryFile() as said:
        start_s = time.monotonic()
        pid = os.fork()
        if pid == 0:
            _be_child(work, said.fileno())
        was_late, end_s = False, start_s + limit_s
        while True:
            done, status, usage = os.wait4(pid, os.WNOHANG)
            if done:
                break
            if time.monotonic() > end_s and not was_late:
                os.kill(pid, signal.SIGKILL)
                was_late = True
            time.sleep(_POLL_S)
        wall_s = time.monotonic() - start_s
        said.seek(0)
        text = said.read().decode(errors='replace')
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, text, wall_s, usage.ru_maxrss / _KIB_PER_MB, was_late)


def _be_child(work: Callable[[], int], stderr: int) -> None:
    status = _RAISED
    try:
        # Its own lock is shared by forks: a child that is killed with it would stop everybody.
        tqdm.set_lock(RLock())
        os.dup2(stderr, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        status = work()
    except SystemExit as error:  # argparse
        status = error.code if isinstance(error.code, int) else 1
    except BaseException:  # noqa: BLE001 - the parent judges whatever it is
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)
