"""Which items the worker processes, keeps waiting and drops."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from hoid_common.errors import MessageError
from hoid_detector.newest_wins import NewestWins


class Bench:
    """A worker whose items end when the test releases them."""

    def __init__(self) -> None:
        self.woken = threading.Semaphore(0)
        self.may_end = threading.Semaphore(0)
        self.worker = NewestWins(self._work, self.woken.release)

    def _work(self, item: int) -> int:
        assert self.may_end.acquire(timeout=5)
        if item < 0:
            raise MessageError('item is negative')
        return 10 * item

    def end_one(self) -> int | None:
        self.may_end.release()
        assert self.woken.acquire(timeout=5)
        return self.worker.finish()


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.may_end.release(10)
    bench.worker.close()


def test_the_newest_waiting_item_is_next(bench: Bench) -> None:
    for item in (1, 2, 3, 4):
        bench.worker.offer(item)
    assert bench.worker.num_dropped == 2
    assert bench.worker.finish() is None  # still running
    assert bench.end_one() == 10
    assert bench.end_one() == 40
    assert bench.worker.finish() is None
    bench.worker.offer(5)
    assert bench.end_one() == 50
    assert bench.worker.num_dropped == 2


def test_an_error_of_one_item_is_raised_and_the_next_is_processed(bench: Bench) -> None:
    bench.worker.offer(-1)
    bench.worker.offer(2)
    with pytest.raises(MessageError, match='negative'):
        bench.end_one()
    assert bench.end_one() == 20


def test_an_item_that_is_not_due_waits_until_it_is_started_or_a_due_one_replaces_it(
    bench: Bench,
) -> None:
    bench.worker.offer(1, is_due=False)
    bench.worker.offer(2, is_due=False)
    assert bench.worker.num_dropped == 1
    bench.worker.start_waiting()
    bench.worker.offer(3, is_due=False)
    assert bench.end_one() == 20
    assert bench.worker.finish() is None  # 3 waits
    bench.worker.offer(4)
    assert bench.end_one() == 40
    assert bench.worker.num_dropped == 2
    bench.worker.start_waiting()  # nothing waits
    bench.worker.offer(5)
    bench.worker.offer(6)
    bench.worker.offer(7, is_due=False)  # in the place of 6, which was due
    assert bench.end_one() == 50
    assert bench.end_one() == 70


def test_clear_discards_all_items(bench: Bench) -> None:
    bench.worker.offer(1)
    bench.worker.offer(2)
    bench.may_end.release()
    bench.worker.clear()
    assert bench.woken.acquire(timeout=5)
    assert bench.worker.finish() is None
    bench.worker.offer(3)
    assert bench.end_one() == 30
