"""Child processes that exchange messages with their parent and end with it.

Starting an interpreter with all imports keeps two cores busy for a second. If a process has called
`preload`, its children are forked from a copy of it instead, which takes milliseconds (decision
030).
"""

from __future__ import annotations

import atexit
import os
import signal
import socket
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
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
from hoid_common.process.signals import signal_handlers_deferred, signals_blocked

Message = TypeVar('Message')
Report = TypeVar('Report')

_EXIT_TIMEOUT_S = 5.0  # chosen: a process that has not ended by itself after this time is killed


class _Mark(Enum):
    END = 'nothing follows'


class ChildEndedError(HoidError):
    """The child process has ended; messages that it has not answered are lost."""


class ChildTimeoutError(HoidError):
    """The child process runs, but has not sent a report in time."""


# Set if this process has a fork server. A child process has none, even if it starts children
# itself, which is rare.
_has_server = Event()


def preload(*modules: str) -> None:
    """Import modules, and start a fork server from which later `ChildWorker`s fork their children.

    The server is a copy of this process, and ends when this process and all children have ended.
    Call this before the first thread starts.
    """
    for module in modules:
        import_module(module)
    # If the server is killed, multiprocessing starts another one with these imports.
    forkserver.set_forkserver_preload(list(modules))
    with _sigint_blocked():
        _fork_server()
    _has_server.set()


def _fork_server() -> None:
    alive, alive_while_open = os.pipe()
    with socket.socket(socket.AF_UNIX) as listener:
        with TemporaryDirectory(prefix='hoid-children-') as folder:  # readable by this user only
            folder_fd = os.open(folder, os.O_PATH)
            # A socket's path is limited to 107 characters; TMPDIR alone may be longer.
            listener.bind(path := f'/proc/self/fd/{folder_fd}/children')
            # The descriptor names the socket even after the folder is removed, so that a killed
            # process leaves no file behind.
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
    vars(forkserver._forkserver).update(  # noqa: SLF001 - there is no public interface
        _forkserver_address=f'/proc/self/fd/{server_fd}',
        _forkserver_alive_fd=alive_while_open,
        _forkserver_pid=server,
    )


def start_child(process: BaseProcess) -> None:
    """Start a process in which SIGINT (Ctrl-C) is blocked, because its parent ends it."""
    with _sigint_blocked(), signal_handlers_deferred():
        process.start()


def _sigint_blocked() -> AbstractContextManager[None]:
    resource_tracker.ensure_running()  # it would unblock the signal if it were started later
    return signals_blocked(signal.SIGINT)


class ChildWorker(Generic[Message, Report]):
    """The parent's end of a child process: sends messages to it and receives its reports.

    Two threads of the parent serve the pipes, so that neither side blocks when it sends. The child
    calls `target` with the connections for messages and for reports, and `args`. `target` must
    return when receiving raises EOFError, because the parent has closed the connection or died.
    """

    def __init__(self, name: str, target: Callable[..., None], *args: object) -> None:
        self._name = name
        self._target = target
        self._args = args
        self.num_restarts = 0
        self._start()

    def send(self, message: Message) -> None:
        """Queue a message, which must not change afterwards; it is lost if the child has ended."""
        self._to_send.put(message)

    @property
    def has_report(self) -> bool:
        return not self._received.empty()

    def receive(self, timeout_s: float) -> Report:
        """Return the child's next report; ChildTimeoutError, or ChildEndedError after the last."""
        try:
            report = self._received.get(timeout=timeout_s)
        except Empty:
            raise ChildTimeoutError(
                f'the process "{self._name}" did not respond within {timeout_s:g} s'
            ) from None
        if isinstance(report, _Mark):
            self._received.put(report)  # so that the next call raises as well
            raise ChildEndedError(f'the process "{self._name}" has ended')
        return report

    def restart(self) -> str:
        """End the child, start a new one, and return how the old one ended (see `close`)."""
        how = self.close()
        self.num_restarts += 1
        self._start()
        return how

    def close(self, patience_s: float = _EXIT_TIMEOUT_S) -> str:
        """End the child, by force after `patience_s`; return how it ended: "exit code 1"."""
        atexit.unregister(self.close)
        self._to_send.put(_Mark.END)
        self._process.join(patience_s)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        for thread in self._threads:  # they end, since the pipes end with the child
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
        # At exit, multiprocessing waits for all children. This handler ends the child before that.
        atexit.register(self.close)
        self._threads = (
            Thread(target=_send_all, args=(self._to_send, messages), daemon=True),
            Thread(target=_receive_all, args=(reports, self._received), daemon=True),
        )
        for thread in self._threads:
            thread.start()


def _send_all(to_send: SimpleQueue[Message | _Mark], pipe: Connection) -> None:
    with pipe, suppress(OSError):  # the child has ended, which `receive` reports
        while not isinstance(message := to_send.get(), _Mark):
            pipe.send(message)


def _receive_all(pipe: Connection, received: SimpleQueue[Report | _Mark]) -> None:
    with pipe, suppress(EOFError, OSError):
        while True:
            received.put(pipe.recv())
    received.put(_Mark.END)
