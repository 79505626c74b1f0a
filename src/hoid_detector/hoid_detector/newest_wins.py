"""Worker thread with a queue of one item, which a newer item replaces."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar('T')
R = TypeVar('R')


class NewestWins(Generic[T, R]):
    """Processes items in a worker thread, one at a time; of the waiting ones, only the newest.

    One thread, the owner, calls the methods. The worker calls `work`, then `wake`, after which the
    owner must call `finish`.
    """

    def __init__(self, work: Callable[[T], R], wake: Callable[[], object]) -> None:
        self._work = work
        self._wake = wake
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._running: Future[R] | None = None
        self._waiting: T | None = None
        self._is_due = False  # whether the waiting item starts as soon as the running one ends
        self.num_dropped = 0  # items that a newer item replaced

    def offer(self, item: T, *, is_due: bool = True) -> None:
        """Replace the waiting item by a new item, and start it if it is due and nothing runs.

        An item that is not due waits for `start_waiting`, unless it replaces a due item.
        """
        if self._waiting is not None:
            self.num_dropped += 1
        self._waiting = item
        self._is_due |= is_due
        if self._is_due:
            self.start_waiting()

    def start_waiting(self) -> None:
        """Start the waiting item, if there is one, now or when the running item ends."""
        self._is_due = self._waiting is not None
        if self._running is None and self._waiting is not None:
            item, self._waiting, self._is_due = self._waiting, None, False
            self._running = self._pool.submit(self._work, item)
            self._running.add_done_callback(lambda _: self._wake())

    def finish(self) -> R | None:
        """Return the worker's result (None after `clear`) or raise its error; start a due item."""
        if self._running is None or not self._running.done():
            return None
        done, self._running = self._running, None
        if self._is_due:
            self.start_waiting()
        return done.result()

    def clear(self) -> None:
        """Discard the waiting item, and the running item with its result or error."""
        self._waiting, self._is_due = None, False
        if self._running is not None:
            self._running.exception()
            self._running = None

    def close(self) -> None:
        self._waiting = None
        self._pool.shutdown()
