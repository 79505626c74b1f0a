"""Worker thread with a queue of one item, which a newer item replaces."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar('T')
R = TypeVar('R')


class NewestWins(Generic[T, R]):
    """Processes one item at a time in a worker thread, while only the newest other item waits.

    All methods must be called by the same thread, so no state needs a lock.

    Args:
        work: Function that processes an item. It runs in the worker thread.
        wake: Function that is called after each item, usually in the worker thread. It must make
            the owner call `finish` in the owner's thread.
    """

    def __init__(self, work: Callable[[T], R], wake: Callable[[], object]) -> None:
        self._work = work
        self._wake = wake
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._running: Future[R] | None = None
        self._waiting: T | None = None
        self.num_dropped = 0  # items that a newer one replaced

    def offer(self, item: T) -> None:
        """Start to process an item, or let it wait while another one is processed.

        An item counts as processed once `finish` has returned its result or raised its error. If
        another item waits already, the new one replaces it, which `num_dropped` counts.
        """
        if self._running is None:
            self._start(item)
        else:
            if self._waiting is not None:
                self.num_dropped += 1
            self._waiting = item

    def finish(self) -> R | None:
        """Return the result of the finished item and start the waiting item, if there is one.

        The result is None if no item has finished. An exception of `work` is raised here.
        """
        if self._running is None or not self._running.done():
            return None
        done, self._running = self._running, None
        if self._waiting is not None:
            item, self._waiting = self._waiting, None
            self._start(item)
        return done.result()

    def clear(self) -> None:
        """Discard the waiting item, wait for the running item, and discard its result or error."""
        self._waiting = None
        if self._running is not None:
            self._running.exception()
            self._running = None

    def close(self) -> None:
        """Discard the waiting item, wait for the running item to end, and end the thread.

        No item may be offered afterwards.
        """
        self._waiting = None
        self._pool.shutdown()

    def _start(self, item: T) -> None:
        self._running = self._pool.submit(self._work, item)
        self._running.add_done_callback(lambda _: self._wake())
