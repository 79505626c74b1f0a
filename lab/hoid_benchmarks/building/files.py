"""What checkpoints and map files of a large map cost."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import psutil

from hoid_benchmarks.building.drive import Drive
from rgbd_slam.records.disk_array import temporary_folder
from rgbd_slam.store import map_file
from rgbd_slam.store.map_writer import MapWriter
from rgbd_slam.store.running_map import RunningMap

T = TypeVar('T')

_MS, _MB = 1e3, 1e6


class Written(NamedTuple):
    """What one checkpoint cost."""

    cpu_s: float
    copy_ms: float  # longest CPU time for which the tracker waits
    num_bytes: int  # written by this process


def checkpoint_costs(drive: Drive, drive_on: Callable[[], None]) -> dict[str, Any]:
    """Return the costs of a first checkpoint, of one more after driving on, and of reading it.

    Args:
        drive: The drive, whose map is written.
        drive_on: Drives on in this map.
    """
    with tempfile.TemporaryDirectory(dir=temporary_folder()) as directory:
        running = RunningMap(directory, 'benchmark')
        writer = running.writer(drive.session.map.atlas)
        first = _write(drive, writer)
        before = drive.num_keyframes
        drive_on()
        more = _write(drive, writer)
        stored, read_s = _timed(running.read)
        assert stored is not None
        if stored.map.digest() != drive.session.map.export().map.digest():
            raise AssertionError('the checkpoint is not the map')
    return {
        'first checkpoint MB': first.num_bytes / _MB,
        'first checkpoint s': first.cpu_s,
        'first copy ms': first.copy_ms,
        'new keyframes': drive.num_keyframes - before,
        'checkpoint MB': more.num_bytes / _MB,
        'checkpoint ms': _MS * more.cpu_s,
        'copy ms': more.copy_ms,
        'read s': read_s,
    }


def load_costs(drive: Drive) -> dict[str, Any]:
    """Save the map to a file, load it in the background, and return what that costs.

    The mapper restores the map at the same time in its own process, which is not counted here.
    """
    session = drive.session
    with tempfile.TemporaryDirectory(dir=temporary_folder()) as directory:
        path = Path(directory) / 'large.hoidmap'
        map_file.save(path, session.map.export())
        content, load_s = _timed(lambda: map_file.load(path))
    loading, prepare_s = _timed(lambda: session.map.prepare_load(content))
    loaded: list[bool] = []
    session.map.begin_load(loading, lambda: loaded.append(True))
    _, restore_s = _timed(loading.restore)
    drive.worker.serve_all()
    _, swap_s = _timed(session.map.update)
    if len(loaded) != 1 or len(session.map.atlas.keyframes) != len(content.map):
        raise AssertionError('the map is not loaded')
    return {'load s': load_s + prepare_s + restore_s, 'swap ms': _MS * swap_s}


def _write(drive: Drive, writer: MapWriter) -> Written:
    start_s, longest_s, before = time.process_time(), 0.0, _written_bytes()
    writer.begin()
    is_complete = False
    while not is_complete:
        part, copy_s = _timed(writer.copy)
        longest_s = max(longest_s, copy_s)
        session = drive.session
        is_complete = writer.append(part, session.map.header(session.stamp_ns))
    cpu_s = time.process_time() - start_s
    return Written(cpu_s, _MS * longest_s, _written_bytes() - before)


def _written_bytes() -> int:
    """Return the number of bytes that this process has written to files so far."""
    return int(psutil.Process().io_counters().write_chars)


def _timed(function: Callable[[], T]) -> tuple[T, float]:
    """Return what a function returns, and its CPU time [s]."""
    start_s = time.process_time()
    value = function()
    return value, time.process_time() - start_s
