"""Reading in a thread, so that a slow disk or decompression does not delay what is due."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from types import TracebackType
from typing import Self

from hoid_bags.live.playback import ScheduledMessage

_LIMIT_BYTES = 64 * 2**20  # about one second of raw VGA colour and depth


class ReadAhead:
    """Iterate over cues that a thread has read in advance; a context manager that ends it.

    It begins with all that it may hold: filling it meanwhile would take a third of a core from
    who listens.
    """

    def __init__(self, cues: Iterator[ScheduledMessage], limit_bytes: int = _LIMIT_BYTES) -> None:
        self._cues, self._limit_bytes = cues, limit_bytes
        self._waiting: deque[ScheduledMessage] = deque()
        self._waiting_bytes = 0
        self._is_done = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, name='read-ahead', daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        with self._changed:
            self._changed.wait_for(lambda: self._is_done or not self._has_room)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._changed:
            self._is_done = True
            self._changed.notify_all()
        self._thread.join()

    def __iter__(self) -> Iterator[ScheduledMessage]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_done)
                if not self._waiting:
                    break
                cue = self._waiting.popleft()
                self._waiting_bytes -= len(cue.data)
                self._changed.notify_all()
            yield cue
        if self._error is not None:
            raise self._error

    @property
    def _has_room(self) -> bool:
        return self._waiting_bytes < self._limit_bytes

    def _read(self) -> None:
        try:
            for cue in self._cues:
                if not self._put(cue):
                    return
        except Exception as error:  # noqa: BLE001 - handed to the thread that iterates
            self._error = error
        with self._changed:
            self._is_done = True
            self._changed.notify_all()

    def _put(self, cue: ScheduledMessage) -> bool:
        """Append a cue once there is room; return whether anybody still wants it."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_done or self._has_room)
            if self._is_done:
                return False
            self._waiting.append(cue)
            self._waiting_bytes += len(cue.data)
            self._changed.notify_all()
        return True
