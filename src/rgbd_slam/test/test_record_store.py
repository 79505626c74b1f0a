"""No record in a file is lost, even if the file cannot be written."""

from __future__ import annotations

import errno
import logging
import os
import tracemalloc
from pathlib import Path
from threading import enumerate as threads

import numpy as np
import pytest
from numpy.typing import NDArray

from rgbd_slam.records.record_store import BLOCK, RecordStore

TYPE = np.dtype([('number', np.int64), ('values', np.float64, (3, 4))])
MANY = 6 * BLOCK + 10


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of the files."""
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    return tmp_path


def fill(store: RecordStore, first: int = 0, end: int = MANY) -> None:
    """Append records, and let each block be written before the next one comes."""
    for n in range(first, end):
        store.append((n, np.full((3, 4), n / 7)))
        if n % BLOCK == 0:
            for thread in threads():
                if thread.name == 'records':
                    thread.join()


def whole(store: RecordStore) -> NDArray[np.void]:
    """Return all records."""
    return np.concatenate(list(store.blocks(len(store))))


def check(store: RecordStore, number: NDArray[np.int64]) -> None:
    """Check that all records are returned bit by bit as they were appended."""
    records = whole(store)
    np.testing.assert_array_equal(records['number'], number)
    np.testing.assert_array_equal(records['values'][:, 2, 3], np.arange(len(number)) / 7)


def test_records_come_back_to_the_bit_and_the_file_has_no_name(folder: Path) -> None:
    store = RecordStore(TYPE, 'records')
    fill(store)
    assert len(store) == MANY
    check(store, np.arange(MANY))
    assert [store[n]['number'] for n in (0, BLOCK, MANY - 1)] == [0, BLOCK, MANY - 1]
    assert store.newest()['number'].tolist() == list(range(5 * BLOCK, MANY))
    assert store.num_unwritten == 0
    assert not list(folder.iterdir())


def test_only_two_blocks_stay_in_memory() -> None:
    tracemalloc.start()
    store = RecordStore(TYPE, 'records')
    fill(store)
    size = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert size < 3 * BLOCK * TYPE.itemsize


def test_old_records_can_be_replaced() -> None:
    store, expected = RecordStore(TYPE, 'records'), np.arange(MANY)
    fill(store, end=MANY - BLOCK)
    for n in (5, BLOCK + 5, MANY - BLOCK - 1):
        record = store[n]
        record['number'] = expected[n] = -n
        store[n] = record
    check(store, expected[: MANY - BLOCK])
    fill(store, MANY - BLOCK)  # which writes the old ones again
    check(store, expected)


def test_what_no_file_takes_stays_in_memory_and_is_said_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(descriptor: int, data: bytes, offset: int) -> int:
        if len(data) < BLOCK * TYPE.itemsize:  # the rest of a block
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data[:100], offset)

    write = os.pwrite
    monkeypatch.setattr(os, 'pwrite', full)
    store = RecordStore(TYPE, 'old records')
    with caplog.at_level(logging.WARNING):
        fill(store)
    (said,) = (r.getMessage() for r in caplog.records)
    assert said.startswith(f'{folder}: cannot be written: No space left on device; old records')
    assert store.num_unwritten == 5 * BLOCK
    check(store, np.arange(MANY))
    monkeypatch.setattr(os, 'pwrite', write)
    fill(store, MANY, 8 * BLOCK)
    assert store.num_unwritten == 0
    check(store, np.arange(8 * BLOCK))


def test_without_the_folder_all_stay_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('TMPDIR', '/dev/null/nowhere')
    store = RecordStore(TYPE, 'records')
    fill(store)
    assert store.num_unwritten == 5 * BLOCK
    check(store, np.arange(MANY))


def test_parts_stay_as_they_were_when_they_were_asked_for() -> None:
    store = RecordStore(TYPE, 'records')
    fill(store, end=BLOCK + 1)
    parts = store.blocks(len(store))
    fill(store, BLOCK + 1)
    assert [len(part) for part in parts] == [BLOCK, 1]
    assert not list(RecordStore(TYPE, 'records').blocks(0))
