"""Arrays in a temporary file keep their content, and stay in memory where there is no space."""

from __future__ import annotations

import errno
import logging
import os

import numpy as np
import pytest

from rgbd_slam.records.disk_array import DiskArray


def test_an_array_keeps_its_content_when_it_grows_and_when_its_memory_is_released() -> None:
    rows = np.arange(24, dtype=np.float32).reshape(4, 3, 2)
    array = DiskArray(rows, 'rows')
    array.grow(6)
    assert array.array.shape == (6, 3, 2)
    np.testing.assert_array_equal(array.array[:4], rows)
    assert not array.array[4:].any()
    array.array[5] = 7.0
    array.release_memory()
    array.grow(4000)
    np.testing.assert_array_equal(array.array[:4], rows)
    assert (array.array[5] == 7.0).all()
    assert not array.array[6:].any()


def test_on_a_full_disk_the_array_stays_in_memory(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def no_space(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    array = DiskArray(np.ones((2, 3)), 'rows')
    array.grow(4)
    monkeypatch.setattr(os, 'posix_fallocate', no_space)
    with caplog.at_level(logging.WARNING):
        array.grow(8)
        array.grow(16)
    assert array.array[:2].all()
    assert not array.array[2:].any()
    assert len(caplog.records) == 1
    assert 'set TMPDIR to another folder' in caplog.text
