"""Checkpoints: the database is the map at one of its versions, whatever happens to its writer."""

from __future__ import annotations

import multiprocessing
import os
import re
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hoid_common.errors import HoidError, MapFileError
from rgbd_slam.store import map_file, map_parts
from rgbd_slam.store.map_file import MapFile

from .checkpoint_robot import CHANGES, HEADER, Robot, change_points, extend, move_keyframes
from .map_content import OCTAVES, SCALE
from .ring_world import MODEL


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def stored_content(robot: Robot) -> MapFile:
    content = robot.running.read()
    assert content is not None
    return content


def kept_maps(robot: Robot) -> set[Path]:
    return set(robot.running.path.parent.glob('kept-*.hoidmap'))


def test_a_checkpoint_is_the_map(robot: Robot) -> None:
    assert robot.running.read() is None
    robot.write(stamp_ns=123)
    content = stored_content(robot)
    assert content.map.digest() == robot.expected()
    assert (content.camera, content.scale_factor, content.num_octaves) == (MODEL, SCALE, OCTAVES)
    assert content.stamp_ns == 123
    keyframes = robot.copy.keyframes
    np.testing.assert_array_equal(content.uids, np.sort(keyframes.uid[keyframes.indices()]))


@pytest.mark.parametrize('change', CHANGES)
def test_each_checkpoint_writes_what_has_changed(robot: Robot, change: str) -> None:
    robot.write()
    before = robot.running.path.stat().st_size
    CHANGES[change](robot)
    robot.write()
    assert robot.stored() == robot.expected()
    assert robot.running.path.stat().st_size < 1.7 * before


def test_an_unchanged_map_changes_only_its_header(robot: Robot) -> None:
    robot.write()
    size = robot.running.path.stat().st_size
    robot.write(stamp_ns=8)
    robot.writer.touch(HEADER._replace(stamp_ns=9))
    assert robot.running.path.stat().st_size == size
    assert stored_content(robot).stamp_ns == 9
    assert robot.stored() == robot.expected()


def test_a_large_map_is_copied_in_parts_between_which_it_changes(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_parts, '_MAX_KEYFRAMES', 2)
    monkeypatch.setattr(map_parts, '_MAX_CHUNKS', 1)
    changes, count = list(CHANGES.values()), 1
    robot.writer.begin()
    while not robot.writer.append(robot.writer.copy(), HEADER):
        if changes:
            changes.pop(0)(robot)
        count += 1
    assert not changes
    assert count > 5
    assert robot.stored() == robot.expected()


def test_rows_that_are_gone_take_no_space(robot: Robot) -> None:
    robot.write()
    once = robot.running.path.stat().st_size
    for _ in range(12):
        change_points(robot)
        robot.mapper.forbid_seeds(2, np.arange(3))
        robot.update()
        robot.write()
        assert robot.stored() == robot.expected()
    assert robot.running.path.stat().st_size < 2 * once


def test_another_map_replaces_the_stored_one(tmp_path: Path, robot: Robot) -> None:
    robot.write()
    other = Robot(tmp_path, 5)
    other.write()
    assert other.stored() == other.expected()
    assert other.stored() != robot.expected()


# ---- kills, full disks and damage


def _write_until_killed(folder: Path, start: int, told: multiprocessing.Queue[str]) -> None:
    robot = Robot(folder)
    robot.writer.begin()
    for n in range(start, 10_000):
        while not robot.writer.append(robot.writer.copy(), HEADER._replace(stamp_ns=n)):
            pass
        told.put(robot.expected())
        # Each change of the points removes some of them, and a fast computer would remove all.
        (change_points if n < start + 10 else move_keyframes)(robot)
        if n == start + 2:
            extend(robot, 8, 10)
        told.put(robot.expected())  # this, or the one before, is what a kill leaves
        robot.writer.begin()


@pytest.mark.parametrize('seed', range(12))
def test_a_process_that_is_killed_leaves_its_last_transaction(tmp_path: Path, seed: int) -> None:
    context = multiprocessing.get_context('fork')
    told: multiprocessing.Queue[str] = context.Queue()
    process = context.Process(target=_write_until_killed, args=(tmp_path, 1, told))
    process.start()
    digests = [told.get(timeout=60)]
    time.sleep(np.random.default_rng(seed).uniform(0, 0.5))
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    while not told.empty():
        digests.append(told.get())
    robot = Robot(tmp_path)
    before = robot.stored()
    # The kill may have cut off the last messages; the map is valid in any case.
    assert before is not None
    assert before in digests or stored_content(robot).stamp_ns >= len(digests) // 2
    assert 'map of ' in robot.running.keep()
    (kept,) = kept_maps(robot)
    assert map_file.load(kept).map.digest() == before
    robot.write()
    assert robot.stored() == robot.expected()


@contextmanager
def full_disk(num_bytes: int) -> Iterator[None]:
    """Let no file grow beyond a size."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, limits[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize('num_bytes', [0, 20_000, 100_000, 300_000, 500_000])
def test_a_full_disk_keeps_the_checkpoint_and_the_next_one_continues(
    robot: Robot, num_bytes: int
) -> None:
    robot.write()
    before = robot.stored()
    extend(robot, 8, 24)
    fault = None
    with full_disk(num_bytes):
        try:
            robot.write()
        except MapFileError as error:
            fault = str(error)
    assert not robot.writer.is_open
    if fault is None:  # the journal holds it, which cannot be brought into the file
        assert robot.stored() == robot.expected()
    else:
        assert re.search(r'cannot be .*written.*space', fault)
        assert robot.stored() == before
    robot.write()
    assert robot.stored() == robot.expected()


def test_a_discarded_checkpoint_is_written_again(robot: Robot) -> None:
    robot.write()
    before = robot.stored()
    extend(robot, 8, 10)
    robot.writer.begin()
    robot.writer.copy()
    robot.writer.abort()
    assert robot.stored() == before
    robot.write()
    assert robot.stored() == robot.expected()


@pytest.mark.parametrize('share', [0.0, 0.1, 0.5, 0.8])
def test_a_damaged_database_is_refused_in_one_line_and_kept(robot: Robot, share: float) -> None:
    robot.write()
    data = robot.running.path.read_bytes()
    robot.running.path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(MapFileError, match=r'^[^\n]*\.running-robot\.hoidmap: [^\n]*$'):
        robot.running.read()
    assert 'kept as' in robot.running.keep()
    (kept,) = kept_maps(robot)
    assert kept.read_bytes() == data[: int(share * len(data))]
    other = Robot(robot.running.path.parent)
    other.write()
    assert other.stored() == other.expected()


def test_between_checkpoints_no_file_is_open_and_the_database_is_one_file(robot: Robot) -> None:
    """Otherwise, the disk could not be made read-only."""
    robot.write()
    change_points(robot)
    robot.write()
    links = (Path(f'/proc/self/fd/{n}') for n in range(3, 200))
    opened = [link.readlink() for link in links if link.is_symlink()]
    folder = robot.running.path.parent
    assert not [path for path in opened if path.parent == folder]
    assert list(folder.iterdir()) == [robot.running.path]


def test_after_somebody_has_deleted_the_database_everything_is_written_again(
    robot: Robot,
) -> None:
    robot.write()
    robot.running.path.unlink()
    change_points(robot)
    robot.write()
    assert robot.stored() == robot.expected()


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    robot = Robot(tmp_path / 'file')
    with pytest.raises(HoidError, match=re.escape(f'{tmp_path}/file: cannot be written')):
        robot.write()


def test_a_kept_map_is_a_saved_map_and_no_checkpoint(robot: Robot) -> None:
    assert robot.running.keep() == ''
    paths: set[Path] = set()
    for number in range(1, 4):
        robot.write()
        before = robot.stored()
        line = robot.running.keep()
        (path,) = kept_maps(robot) - paths
        assert line.startswith(f'map of 8 keyframes kept as {path}; load it')
        assert f'{number} kept maps take ' in line
        assert map_file.load(path).map.digest() == before
        assert robot.running.read() is None
        assert not robot.running.path.exists()
        paths.add(path)


def test_an_empty_database_is_not_kept(robot: Robot) -> None:
    robot.writer.begin()
    robot.writer.abort()
    assert robot.running.path.exists()
    assert robot.running.read() is None
    assert robot.running.keep() == ''
    assert list(robot.running.path.parent.iterdir()) == []


def test_a_copy_is_a_saved_map(robot: Robot, tmp_path: Path) -> None:
    robot.write()
    robot.running.copy_to(tmp_path / 'home.hoidmap')
    assert map_file.load(tmp_path / 'home.hoidmap').map.digest() == robot.expected()


def test_the_checkpoint_of_an_earlier_version_is_found_and_not_read(robot: Robot) -> None:
    assert robot.running.outdated() == ''
    old = robot.running.path.with_name('.checkpoint-robot')
    old.mkdir()
    assert str(old) in robot.running.outdated()
    assert robot.running.read() is None
    robot.write()
    assert old.exists()
