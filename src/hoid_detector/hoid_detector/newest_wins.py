"""Worker thread with a queue of one item, which a newer item replaces."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar('T')
R = TypeVar('R')


class NewestWins(Generic[T, R]):
    """Processes one item at a time in a worker thread, while only the newest other item waits.

    One thread calls the methods. The worker calls `work`, then `wake`, after which the owner must
    call `finish`.
    """

    def __init__(self, work: Callable[[T], R], wake: Callable[[], object]) -> None:
        self._work = work
        self._wake = wake
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._running: Future[R] | None = None
        self._waiting: T | None = None
        self.num_dropped = 0  # items that a newer one replaced

    def offer(self, item: T) -> None:
        """Process an item now, or after the running one in place of the one that waits."""
        if self._running is None:
            self._start(item)
        else:
            if self._waiting is not None:
                self.num_dropped += 1
            self._waiting = item

    def finish(self) -> R | None:
        """Return the finished result or None, or raise its error; start the waiting item."""
        if self._running is None or not self._running.done():
            return None
        done, self._running = self._running, None
        if self._waiting is not None:
            item, self._waiting = self._waiting, None
            self._start(item)
        return done.result()

    def clear(self) -> None:
        """Discard the waiting item, and the running one with its result or error."""
        self._waiting = None
        if self._running is not None:
            self._running.exception()
            self._running = None

    def close(self) -> None:
        self._waiting = None
        self._pool.shutdown()

    def _start(self, item: T) -> None:
        self._running = self._pool.submit(self._work, item)
        self._running.add_done_callback(lambda _: self._wake())
