"""Work in a thread of its own that is never late by a queue: the newest item wins."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar('T')
R = TypeVar('R')


class NewestWins(Generic[T, R]):
    """Works on one item at a time; of those that come meanwhile it keeps the newest.

    All methods are to be called by one thread, so that no state needs a lock.

    Args:
        work: called in the worker's thread.
        wake: called in the worker's thread when it is done; has to get `finish` called.
    """

    def __init__(self, work: Callable[[T], R], wake: Callable[[], object]) -> None:
        self._work = work
        self._wake = wake
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._running: Future[R] | None = None
        self._waiting: T | None = None
        self.num_dropped = 0  # items that a newer one replaced

    def offer(self, item: T) -> None:
        """Start on the item, or let it wait in the place of one that waits."""
        if self._running is None:
            self._start(item)
        else:
            self.num_dropped += self._waiting is not None
            self._waiting = item

    def finish(self) -> R | None:
        """Return the result of a work that is done and start the next; raises what it raised."""
        if self._running is None or not self._running.done():
            return None
        done, self._running = self._running, None
        if self._waiting is not None:
            item, self._waiting = self._waiting, None
            self._start(item)
        return done.result()

    def clear(self) -> None:
        """Forget the item that waits, and wait for the one in work, whose result is lost."""
        self._waiting = None
        if self._running is not None:
            self._running.exception()
            self._running = None

    def close(self) -> None:
        """End the thread when its work is done."""
        self._waiting = None
        self._pool.shutdown()

    def _start(self, item: T) -> None:
        self._running = self._pool.submit(self._work, item)
        self._running.add_done_callback(lambda _: self._wake())
