"""Processes that work for this one and end with it.

A `ChildWorker` runs a function in a process of its own. Messages go to it and reports come back
through two pipes, moved by two threads, so that neither side ever waits for the other.

A new interpreter that imports what a child needs takes a second of two busy cores. The children of
a process that has called `preload` need none: they are forks of a copy of it.
"""

from __future__ import annotations

import atexit
import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from importlib import import_module
from multiprocessing import forkserver, get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Generic, TypeVar

from hoid_common.errors import HoidError
from hoid_common.process.signals import handlers_deferred

Message = TypeVar('Message')
Report = TypeVar('Report')

_PATIENCE_S = 5.0  # for a process to end by itself


class _Mark(Enum):
    END = 'nothing follows'


class ChildEndedError(HoidError):
    """The process has ended, and with it all that it was asked for."""


class ChildTimeoutError(HoidError):
    """The process is there but does not answer."""


_has_server = Event()  # of this process; the children of a child are rare and start by themselves


def preload(*modules: str) -> None:
    """Import modules, and have all later children of this process be forks of what it is now.

    A copy of it waits to be forked, and ends with the last of them and this one. To be called
    before there is anything that a fork must not have, such as threads of Python.
    """
    for module in modules:
        import_module(module)
    forkserver.set_forkserver_preload(list(modules))  # for another server, if this one is killed
    with _deaf_to_ctrl_c():
        _fork_server()
    _has_server.set()


def _fork_server() -> None:
    """Do as `forkserver.ensure_running`, without the new interpreter that imports all again."""
    alive, alive_while_open = os.pipe()
    with socket.socket(socket.AF_UNIX) as listener:
        with TemporaryDirectory(prefix='hoid-children-') as folder:  # for this user alone
            folder_fd = os.open(folder, os.O_PATH)
            # By its descriptor: a socket's path ends after 107 characters, maybe in its folder's.
            listener.bind(path := f'/proc/self/fd/{folder_fd}/children')
            # Goes on to name the socket when the folder is gone: no kill leaves anything behind.
            server_fd = os.open(path, os.O_PATH)
            os.close(folder_fd)
        listener.listen()
        server = os.fork()
        if server == 0:
            os.close(alive_while_open)
            try:
                forkserver.main(listener.detach(), alive, ())
            finally:
                os._exit(0)
    os.close(alive)
    vars(forkserver._forkserver).update(  # noqa: SLF001 - it has no other way in
        _forkserver_address=f'/proc/self/fd/{server_fd}', _forkserver_alive_fd=alive_while_open,
        _forkserver_pid=server,
    )  # fmt: skip


def start_child(process: BaseProcess) -> None:
    """Start a process that never hears SIGINT, not even while it still imports.

    Ctrl-C reaches all processes of a terminal, but who started this one ends it, in its own time.
    """
    with _deaf_to_ctrl_c(), handlers_deferred():
        process.start()


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Block SIGINT rather than ignore it, as a process that is started inherits that."""
    resource_tracker.ensure_running()  # which would unblock the signal if it were started below
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class ChildWorker(Generic[Message, Report]):
    """The parent's end of a process; all methods but `close` and `restart` return at once.

    Args:
        name: Of the process, in errors as well.
        target: Its main function: called with the connection that messages come from, the one
            that reports go to, and `args`. It returns when the first one ends (`EOFError`), which
            it does when this process closes it or is killed.
        args: What the process is to know from the start; all must be picklable.
    """

    def __init__(self, name: str, target: Callable[..., None], *args: object) -> None:
        self._name = name
        self._target = target
        self._args = args
        self.num_restarts = 0
        self._start()

    @property
    def process_id(self) -> int | None:
        """Return the id of the process."""
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Return whether the process is there."""
        return self._process.is_alive()

    @property
    def num_waiting(self) -> int:
        """Return how many messages the process has not taken yet."""
        return self._to_send.qsize()

    def send(self, message: Message) -> None:
        """Hand a message over; it is lost when the process has ended."""
        self._to_send.put(message)

    @property
    def has_report(self) -> bool:
        """Return whether `receive` has something to say at once."""
        return not self._received.empty()

    def receive(self, timeout_s: float) -> Report:
        """Return the next report, in the order in which they were sent.

        Raises:
            ChildEndedError: The process has ended, and all that it reported was received.
            ChildTimeoutError: There is none in time.
        """
        try:
            report = self._received.get(timeout=timeout_s)
        except Empty:
            raise ChildTimeoutError(
                f'the process "{self._name}" gives no answer in {timeout_s:g} s'
            ) from None
        if isinstance(report, _Mark):
            self._received.put(report)  # for whoever asks next
            raise ChildEndedError(f'the process "{self._name}" has ended')
        return report

    def restart(self) -> str:
        """Start another process in its place and return how this one ended, as `close` does.

        What was under way in either direction is lost: tell the new one all that it must know.
        """
        how = self.close()
        self.num_restarts += 1
        self._start()
        return how

    def close(self, patience_s: float = _PATIENCE_S) -> str:
        """End the process, by force when it does not end by itself in time.

        Args:
            patience_s: How long it may take to work off what was sent and to return.

        Returns:
            How it ended: "exit code 1", "signal 9".
        """
        atexit.unregister(self.close)
        self._to_send.put(_Mark.END)
        self._process.join(patience_s)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        for thread in self._threads:  # the pipes have ended with the process
            thread.join()
        code = self._process.exitcode
        return f'signal {-code}' if code is not None and code < 0 else f'exit code {code}'

    def _start(self) -> None:
        self._to_send: SimpleQueue[Message | _Mark] = SimpleQueue()
        self._received: SimpleQueue[Report | _Mark] = SimpleQueue()
        context = get_context('forkserver') if _has_server.is_set() else get_context('spawn')
        message_reader, messages = context.Pipe(duplex=False)
        reports, report_writer = context.Pipe(duplex=False)
        self._process: BaseProcess = context.Process(
            target=self._target, args=(message_reader, report_writer, *self._args), name=self._name
        )
        start_child(self._process)
        message_reader.close()
        report_writer.close()
        atexit.register(self.close)  # before multiprocessing waits for the process
        self._threads = (
            Thread(target=_send_all, args=(self._to_send, messages), daemon=True),
            Thread(target=_receive_all, args=(reports, self._received), daemon=True),
        )
        for thread in self._threads:
            thread.start()


def _send_all(to_send: SimpleQueue[Message | _Mark], pipe: Connection) -> None:
    """Send until told to end; only this thread uses, and closes, its end of the pipe."""
    with pipe, suppress(OSError):  # the process has ended; who receives from it is told
        while not isinstance(message := to_send.get(), _Mark):
            pipe.send(message)


def _receive_all(pipe: Connection, received: SimpleQueue[Report | _Mark]) -> None:
    with pipe, suppress(EOFError, OSError):
        while True:
            received.put(pipe.recv())
    received.put(_Mark.END)
