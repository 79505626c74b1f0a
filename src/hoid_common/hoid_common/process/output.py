"""A relay of stdout and stderr that never blocks: it drops the oldest lines that nobody reads.

A process that writes to a full pipe, or to a terminal that was stopped by Ctrl-S, blocks until
somebody reads. The console handler of ROS then holds Python's interpreter lock. Here a second
process waits instead; a thread would need the lock.
"""

from __future__ import annotations

import atexit
import os
import select
import signal
import socket
import stat
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from typing import NoReturn

from hoid_common.process.signals import NODE_END_SIGNALS

_STREAMS = (1, 2)  # stdout and stderr
_MARK = 'HOID_RELAYED_OUTPUT'  # environment variable that lists the pipes that a relay reads
_COLORS = 'RCUTILS_COLORIZED_OUTPUT'
_MAX_WAITING_BYTES = 1 << 18  # chosen: about the last 2,000 lines
_READ_BYTES = 1 << 16  # capacity of a pipe
# A pipe that is ready accepts this many bytes without blocking (pipe(7)).
_WRITE_BYTES = select.PIPE_BUF
# Chosen: pause if a stream accepts nothing although `select` reports it as writable.
_RETRY_S = 0.05
_PATIENCE_S = 1.0  # chosen: how long the relay waits for a reader after the process has ended


def relay_output(*, terminals: bool = True) -> None:
    """Send stdout and stderr through a child process, so that writing never blocks this process.

    While nobody reads, the child keeps the last 256 KiB; it drops and counts older lines. Output
    to files or to a parent's relay is left alone, and output to a terminal too if `terminals` is
    False, because programs draw no progress bars to a relay's pipe. Call this before threads
    exist, because it forks.
    """
    relayed = os.environ.get(_MARK, '').split()
    streams: dict[str, list[int]] = {}  # stdout and stderr by the file they lead to
    for stream in _STREAMS:
        identity = _identity(stream)
        if identity and identity not in relayed and _may_block(stream, terminals=terminals):
            streams.setdefault(identity, []).append(stream)
    if not streams:
        return
    if any(os.isatty(stream) for same in streams.values() for stream in same):
        os.environ.setdefault(_COLORS, '1')
    _flush()
    pipes = [(*os.pipe(), same) for same in streams.values()]
    finish_reader, finish = os.pipe()
    relay = os.fork()
    if relay == 0:
        _run([(reader, same[0]) for reader, _, same in pipes], finish_reader)
    for reader, writer, same in pipes:
        for stream in same:
            os.dup2(writer, stream)
        os.close(reader)
        os.close(writer)
    os.close(finish_reader)
    os.environ[_MARK] = ' '.join([*relayed, *(_identity(same[0]) for _, _, same in pipes)])
    atexit.register(_finish, relay, finish, os.getpid())


def _identity(stream: int) -> str:
    try:
        info = os.fstat(stream)
    except OSError:
        return ''
    return f'{info.st_dev}:{info.st_ino}'


def _may_block(stream: int, *, terminals: bool) -> bool:
    mode = os.fstat(stream).st_mode
    if stat.S_ISCHR(mode):
        return terminals and os.isatty(stream)
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def _flush() -> None:
    for file in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # the stream is closed
            file.flush()


def _finish(relay: int, finish: int, owner: int) -> None:
    """At exit of process `owner`, wait at most 1 s until the relay has written everything.

    The relay gets a message, because its pipe stays open in children of this process.
    """
    if os.getpid() == owner:
        _flush()
        with suppress(OSError):
            os.write(finish, b'.')
            os.waitpid(relay, 0)


def _run(pairs: Iterable[tuple[int, int]], finish: int) -> NoReturn:
    try:
        for sign in NODE_END_SIGNALS:
            signal.signal(sign, signal.SIG_IGN)
        channels = [_Channel(reader, stream) for reader, stream in pairs]
        _close_all_but({finish, *(fd for c in channels for fd in (c.reader, c.stream))})
        _relay(channels, finish)
        _offer_rest(channels)
    finally:
        os._exit(0)


def _close_all_but(kept: set[int]) -> None:
    """Close all file descriptors except `kept`, which would keep pipes of the process open."""
    before = 0
    for descriptor in [*sorted(kept), os.sysconf('SC_OPEN_MAX')]:
        os.closerange(before, descriptor)
        before = descriptor + 1


def _relay(channels: list[_Channel], finish: int) -> None:
    while open_pipes := [channel.reader for channel in channels if channel.is_open]:
        targets = [channel.stream for channel in channels if channel.waits]
        ready, writable, _ = select.select([finish, *open_pipes], targets, [])
        for channel in channels:
            if channel.reader in ready:
                channel.read()
            if channel.stream in writable:
                channel.write()
        if finish in ready:
            for channel in channels:
                channel.read_rest()


def _offer_rest(channels: list[_Channel]) -> None:
    end_s = time.monotonic() + _PATIENCE_S
    while targets := [channel for channel in channels if channel.waits]:
        left_s = end_s - time.monotonic()
        if left_s <= 0:
            return
        _, writable, _ = select.select([], [channel.stream for channel in targets], [], left_s)
        for channel in targets:
            if channel.stream in writable:
                channel.write()


class _Channel:
    """A buffer of output for one stream; it comes from the pipe `reader`."""

    def __init__(self, reader: int, stream: int) -> None:
        self.reader, self.is_open = reader, True
        os.set_blocking(reader, False)
        try:
            # The stream is opened again: all processes that have inherited a descriptor share its
            # mode, which must not change for them.
            flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_APPEND
            self.stream = os.open(f'/proc/self/fd/{stream}', flags)
        except OSError:  # the stream is a socket
            self.stream = os.dup(stream)
        self._is_socket = stat.S_ISSOCK(os.fstat(self.stream).st_mode)
        self._waiting = bytearray()
        self._num_lost = 0  # number of lost lines
        self._is_in_line = False  # whether the last write ended within a line
        self._is_dead = False

    @property
    def waits(self) -> bool:
        return bool(self._waiting) and not self._is_dead

    def read(self) -> bool:
        """Read new output of the process, and drop the oldest lines beyond the limit."""
        try:
            data = os.read(self.reader, _READ_BYTES)
        except BlockingIOError:
            return False
        self.is_open = bool(data)
        self._waiting += data
        num_excess = len(self._waiting) - _MAX_WAITING_BYTES
        if num_excess > 0:
            end = self._waiting.find(b'\n', num_excess - 1) + 1 or len(self._waiting)
            self._num_lost += self._waiting.count(b'\n', 0, end)
            del self._waiting[:end]
        return self.is_open

    def read_rest(self) -> None:
        while self.read():
            pass
        self.is_open = False

    def write(self) -> None:
        """Write up to PIPE_BUF bytes of the buffer, after a note about dropped lines."""
        if self._num_lost:
            note = f'[{self._num_lost} lines of output were dropped: nobody read them in time]\n'
            self._waiting[:0] = ('\n' * self._is_in_line + note).encode()
            self._num_lost = 0
        part = bytes(self._waiting[:_WRITE_BYTES])
        try:
            size = self._send(part)
        except BlockingIOError:
            time.sleep(_RETRY_S)
        except OSError:  # the reader is gone
            self._is_dead = True
        else:
            self._is_in_line = part[:size][-1:] != b'\n'
            del self._waiting[:size]

    def _send(self, part: bytes) -> int:
        if not self._is_socket:
            return os.write(self.stream, part)
        with socket.socket(fileno=os.dup(self.stream)) as target:
            return target.send(part, socket.MSG_DONTWAIT)
