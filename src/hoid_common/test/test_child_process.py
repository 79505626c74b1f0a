"""Child processes that work, die, block and are replaced."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Event, Thread, get_ident
from types import ModuleType
from typing import Any, cast

import pytest

from hoid_common.process.child_process import (
    ChildEndedError,
    ChildTimeoutError,
    ChildWorker,
    start_child,
)

_LIMIT_S = 60.0  # for a child process to start on a busy machine
_TARGETS = """
import os, time
from contextlib import suppress

LOADED_BY = os.getpid()

def tell_who_loaded(messages, reports):
    reports.send((LOADED_BY, os.getpid(), os.getppid()))

def multiply(messages, reports, factor):
    reports.send('ready')
    with suppress(EOFError):
        while True:
            number = messages.recv()
            if number is None:
                os._exit(3)
            reports.send(factor * number)

def sleep(messages, reports):
    reports.send('ready')
    time.sleep(600)
"""


@pytest.fixture(name='targets')
def fixture_targets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """Return a module of functions that a child process can import."""
    (tmp_path / 'child_targets.py').write_text(_TARGETS)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module('child_targets')
    importlib.sys.modules.pop('child_targets')  # type: ignore[attr-defined]


def started(worker: ChildWorker[Any, Any]) -> ChildWorker[Any, Any]:
    assert worker.receive(_LIMIT_S) == 'ready'
    return worker


def test_reports_keep_their_order_and_close_processes_all_messages(targets: ModuleType) -> None:
    worker = started(ChildWorker('sums', targets.multiply, 7))
    assert active_children()
    assert not worker.has_report
    for number in (1, 2, 3):
        worker.send(number)
    assert [worker.receive(_LIMIT_S) for _ in range(3)] == [7, 14, 21]
    worker.send(4)
    assert worker.close() == 'exit code 0'
    assert worker.receive(0.0) == 28
    assert not active_children()
    assert worker.close() == 'exit code 0'


def test_receive_raises_after_the_last_report_of_a_dead_child(targets: ModuleType) -> None:
    worker = started(ChildWorker('sums', targets.multiply, 7))
    worker.send(5)
    worker.send(None)
    assert worker.receive(_LIMIT_S) == 35
    for _ in range(2):
        with pytest.raises(ChildEndedError, match='the process "sums" has ended'):
            worker.receive(_LIMIT_S)
    worker.send(6)  # this message is lost
    assert worker.close() == 'exit code 3'


def test_restart_replaces_a_killed_child(targets: ModuleType) -> None:
    worker = started(ChildWorker('sums', targets.multiply, 7))
    (first,) = active_children()
    first.kill()
    with pytest.raises(ChildEndedError):
        worker.receive(_LIMIT_S)
    assert worker.restart() == 'signal 9'
    started(worker).send(2)
    assert worker.receive(_LIMIT_S) == 14
    assert worker.num_restarts == 1
    assert active_children() != [first]
    worker.close()


def test_close_kills_a_child_that_does_not_receive(targets: ModuleType) -> None:
    worker = started(ChildWorker('sleeper', targets.sleep))
    worker.send(bytes(1 << 20))  # more than a pipe can buffer, so that its sender blocks as well
    worker.send(1)
    with pytest.raises(ChildTimeoutError, match=r'"sleeper" did not respond within 0\.01 s'):
        worker.receive(0.01)
    before_s = time.monotonic()
    assert worker.close(patience_s=0.1) == 'signal 9'
    assert time.monotonic() - before_s < 5.0


_PRELOADING = """
import os, signal, tempfile, child_targets
from hoid_common.process.child_process import ChildWorker, preload

def reported(worker):
    loader, own, parent = worker.receive(60)
    how = worker.close()
    assert how == 'exit code 0', how
    return loader, own, parent

preload('child_targets')
assert not os.listdir(tempfile.gettempdir()), 'a kill would leave this behind'
before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
workers = [ChildWorker('teller', child_targets.tell_who_loaded) for _ in range(2)]
(me, first, server), (_, second, same) = map(reported, workers)
assert me == os.getpid(), 'a child has imported by itself'
assert server == same
assert len({me, first, second, server}) == 4
assert signal.SIGINT not in before

os.kill(server, signal.SIGKILL)
os.waitid(os.P_PID, server, os.WEXITED | os.WNOWAIT)
workers[0].restart()
loader, own, other = reported(workers[0])
assert loader == other != server, 'no other server has loaded it'
print(other)
"""


@pytest.mark.slow
def test_children_are_forked_from_a_process_with_preloaded_modules(
    targets: ModuleType, tmp_path_factory: pytest.TempPathFactory
) -> None:
    # Short, since a socket path is limited to 107 characters.
    scratch = tmp_path_factory.mktemp('s')
    paths = (str(Path(str(targets.__file__)).parent), *sys.path)
    done = subprocess.run(
        [sys.executable, '-c', _PRELOADING], check=False, timeout=60, capture_output=True,
        text=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths), 'TMPDIR': str(scratch)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    end_s = time.monotonic() + 5.0
    while Path(f'/proc/{done.stdout.strip()}').exists():  # the fork server ends with its process
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_sigint_does_not_end_a_starting_child() -> None:
    child = get_context('spawn').Process(target=os._exit, args=(7,))
    start_child(child)
    assert child.pid is not None
    os.kill(child.pid, signal.SIGINT)  # before its interpreter has started
    child.join(60)
    assert child.exitcode == 7


def test_sigint_still_interrupts_the_parent() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert signal.SIGINT not in before
    child = get_context('spawn').Process(target=os._exit, args=(0,))
    start_child(child)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before
    child.join(60)
    assert child.exitcode == 0


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Restore the handler of SIGINT, which a shell ignores for background processes."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures('interruptible')
def test_a_signal_to_another_thread_is_deferred_until_the_child_is_started() -> None:
    begun, stages = Event(), []

    def interrupt() -> None:
        begun.wait()
        signal.pthread_kill(get_ident(), signal.SIGINT)

    thread = Thread(target=interrupt)
    thread.start()

    class Child:
        def start(self) -> None:
            stages.append('has begun')
            begun.set()
            thread.join()
            stages.append('has all it needs')

    with pytest.raises(KeyboardInterrupt):
        start_child(cast(BaseProcess, Child()))
    assert stages == ['has begun', 'has all it needs']
