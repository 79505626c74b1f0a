"""Worker thread with a queue of one item, which a newer item replaces."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar('T')
R = TypeVar('R')


class NewestWins(Generic[T, R]):
    """Processes one item at a time in a worker thread; meanwhile only the newest item waits.

    All methods must be called by the same thread, so no state needs a lock.

    Args:
        work: Processes an item, in the worker thread.
        wake: Called in the worker thread after each item; it must make the owner call `finish`.
    """

    def __init__(self, work: Callable[[T], R], wake: Callable[[], object]) -> None:
        self._work = work
        self._wake = wake
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._running: Future[R] | None = None
        self._waiting: T | None = None
        self.num_dropped = 0  # items that a newer one replaced

    def offer(self, item: T) -> None:
        """Start on the item, or let it wait in place of an older one."""
        if self._running is None:
            self._start(item)
        else:
            self.num_dropped += self._waiting is not None
            self._waiting = item

    def finish(self) -> R | None:
        """Return the result of a finished item, or None, and start the waiting one.

        An exception of `work` is raised here.
        """
        if self._running is None or not self._running.done():
            return None
        done, self._running = self._running, None
        if self._waiting is not None:
            item, self._waiting = self._waiting, None
            self._start(item)
        return done.result()

    def clear(self) -> None:
        """Discard the waiting item and the result of the running one, for whose end it waits."""
        self._waiting = None
        if self._running is not None:
            self._running.exception()
            self._running = None

    def close(self) -> None:
        """Discard the waiting item and end the thread after the running one."""
        self._waiting = None
        self._pool.shutdown()

    def _start(self, item: T) -> None:
        self._running = self._pool.submit(self._work, item)
        self._running.add_done_callback(lambda _: self._wake())
