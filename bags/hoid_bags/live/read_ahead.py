"""Reading in a thread, so that a slow disk or decompression does not delay due messages."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from typing import Self

from hoid_bags.live.playback import ScheduledMessage
from hoid_common.values import NS_PER_S

_LIMIT_BYTES = 64 * 2**20  # chosen: about one second of raw VGA color and depth images
# Chosen: longer than a disk pauses. Without this limit, a bag of a few bytes that is repeated
# would be read for minutes before its first message is played.
_LIMIT_S = 10.0


class ReadAhead:
    """Iterable of messages that a thread reads in advance; a context manager for the thread.

    An error of the thread is raised after the last message that it has read.

    The buffer is filled before the first message is yielded. Filling it during the playback would
    take a third of a core from the nodes that receive the messages.

    Args:
        rate: Speed of the playback as a multiple of real time. The buffer holds no more messages
            than are played in ten seconds of real time.
    """

    def __init__(
        self,
        messages: Iterator[ScheduledMessage],
        limit_bytes: int = _LIMIT_BYTES,
        *,
        rate: float = 1.0,
    ) -> None:
        self._messages, self._limit_bytes = messages, limit_bytes
        self._limit_ns = round(_LIMIT_S * rate * NS_PER_S)
        self._waiting: deque[ScheduledMessage] = deque()
        self._waiting_bytes = 0
        self._is_done = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, name='read-ahead', daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        with self._changed:
            self._changed.wait_for(lambda: self._is_done or not self._has_space)
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._thread.join()

    def __iter__(self) -> Iterator[ScheduledMessage]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_done)
                if not self._waiting:
                    break
                message = self._waiting.popleft()
                self._waiting_bytes -= len(message.data)
                self._changed.notify_all()
            yield message
        if self._error is not None:
            raise self._error

    @property
    def _has_space(self) -> bool:
        if not self._waiting:
            return True
        span_ns = self._waiting[-1].time_ns - self._waiting[0].time_ns
        return self._waiting_bytes < self._limit_bytes and span_ns < self._limit_ns

    def _read(self) -> None:
        try:
            for message in self._messages:
                with self._changed:
                    self._changed.wait_for(lambda: self._is_done or self._has_space)
                    if self._is_done:
                        return
                    self._waiting.append(message)
                    self._waiting_bytes += len(message.data)
                    self._changed.notify_all()
        except Exception as error:  # noqa: BLE001 - handed to the thread that iterates
            self._error = error
        self._end()

    def _end(self) -> None:
        with self._changed:
            self._is_done = True
            self._changed.notify_all()
