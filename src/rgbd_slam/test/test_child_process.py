"""Processes that only their parent ends."""

from __future__ import annotations

import os
import signal
from multiprocessing import get_context

from hoid_common.child_process import start_child


def test_a_child_outlives_ctrl_c_also_while_it_starts() -> None:
    child = get_context('spawn').Process(target=os._exit, args=(7,))
    start_child(child)
    assert child.pid is not None
    os.kill(child.pid, signal.SIGINT)  # its interpreter has not even begun
    child.join(60)
    assert child.exitcode == 7


def test_the_parent_hears_ctrl_c_as_before() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert signal.SIGINT not in before
    child = get_context('spawn').Process(target=os._exit, args=(0,))
    start_child(child)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before
    child.join(60)
    assert child.exitcode == 0
