"""Checkpoints: what was appended comes back, whenever the writing process is killed."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_common.errors import MapFileError
from hoid_scene.dense.submap_export import SubmapExports
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.map_io import checkpoint, checkpoint_folder, map_parts
from rgbd_slam.map_io.map_parts import KeyframeCopy
from rgbd_slam.model.map_state import snapshot

from .checkpoint_robot import (
    CHANGES,
    CONFIG,
    HEADER,
    Robot,
    change_points,
    cull,
    extend,
    no_evidence,
    submap,
    surface,
)
from .map_content import OCTAVES, SCALE, objects_of
from .ring_world import MODEL


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def test_a_checkpoint_is_the_map(robot: Robot) -> None:
    assert robot.folder.read() is None
    robot.write(stamp_ns=123)
    assert robot.stored() == robot.expected()
    checkpoint = robot.folder.read()
    assert checkpoint is not None
    assert checkpoint.stamp_ns == 123
    content = checkpoint.content
    assert (content.camera, content.scale_factor, content.num_octaves) == (MODEL, SCALE, OCTAVES)
    assert content.dense is None


@pytest.mark.parametrize('change', CHANGES)
def test_each_checkpoint_adds_what_has_changed(robot: Robot, change: str) -> None:
    robot.write()
    before = robot.writer.total_bytes
    CHANGES[change](robot)
    robot.write()
    assert robot.stored() == robot.expected()
    assert robot.writer.total_bytes < 1.7 * before


def test_an_unchanged_map_adds_only_an_index(robot: Robot) -> None:
    robot.write()
    sizes = segment_sizes(robot)
    robot.write()
    assert segment_sizes(robot) == sizes
    assert robot.stored() == robot.expected()


def test_a_large_map_is_copied_in_parts_between_which_it_changes(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_parts, '_MAX_KEYFRAMES', 2)
    monkeypatch.setattr(map_parts, '_MAX_POINTS', 60)
    changes = list(CHANGES.values())
    part, count = robot.writer.parts.copy(), 0
    while part.keyframes is None:
        robot.writer.append(part)
        if changes:
            changes.pop(0)(robot)
        part, count = robot.writer.parts.copy(), count + 1
    robot.writer.append(part)
    assert count > 5
    robot.writer.finish(HEADER, part.keyframes, None, 7)
    assert robot.stored() == robot.expected()


def test_dead_rows_are_removed_from_the_disk(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, '_SPARE_BYTES', 1000)
    robot.write()
    once = sum(segment_sizes(robot).values())
    for _ in range(12):
        j = robot.mapper.points.indices()
        robot.mapper.set_positions(j, robot.mapper.points.position_m[j] + 0.001)
        robot.mapper.forbid_seeds(2, np.arange(3))
        robot.update()
        robot.write()
        assert robot.stored() == robot.expected()
        assert sum(segment_sizes(robot).values()) < 4 * once
    names = segment_sizes(robot)
    robot.write()
    assert len(segment_sizes(robot)) <= len(names)


def test_another_map_replaces_the_checkpoint(tmp_path: Path, robot: Robot) -> None:
    robot.write()
    names = set(segment_sizes(robot))
    other = Robot(tmp_path, 5)
    other.write()
    assert other.stored() == other.expected()
    assert not names & set(segment_sizes(other))


def test_the_dense_map_adds_only_changed_submaps(robot: Robot) -> None:
    uids = np.sort(robot.copy.keyframes.uid[robot.copy.keyframes.indices()])
    submaps = [submap(uid, n) for n, uid in enumerate(uids[:4].tolist())]
    exports = SubmapExports(CONFIG)

    def write() -> SubmapState:
        export = exports.since(robot.writer.submaps_since, submaps, uids)
        part = robot.writer.parts.copy()
        robot.writer.append(part)
        assert part.keyframes is not None
        robot.bytes = robot.writer.finish(HEADER, part.keyframes, export, 7)
        stored = robot.folder.read()
        assert stored is not None
        assert isinstance(stored.content.dense, SubmapState)
        return stored.content.dense

    def expected() -> SubmapState:
        return SubmapState.of_submaps(submaps, uids, CONFIG)

    assert write().digest() == expected().digest()
    first = robot.bytes
    submaps[2].update(no_evidence(len(submaps[2])), surface(9))
    del submaps[1]
    assert write().digest() == expected().digest()
    assert robot.bytes < first / 2
    part = robot.writer.parts.copy()
    robot.writer.append(part)
    assert part.keyframes is not None
    robot.writer.finish(HEADER, part.keyframes, None, 7, keep_submaps=True)
    stored = robot.folder.read()
    assert stored is not None
    assert stored.content.dense is not None
    assert stored.content.dense.digest() == expected().digest()


def test_objects_are_kept_while_they_are_unknown(robot: Robot) -> None:
    objects = objects_of(snapshot(robot.copy))
    robot.writer.finish(HEADER, appended(robot), None, 7, objects=objects)
    assert stored_objects(robot).digest() == objects.digest()
    extend(robot, 8, 10)
    robot.writer.finish(HEADER, appended(robot), None, 8, keep_submaps=True)
    assert stored_objects(robot).digest() == objects.digest()
    cull(robot)
    robot.writer.finish(HEADER, appended(robot), None, 9, keep_submaps=True)
    assert stored_objects(robot).digest() == objects.digest()
    robot.writer.finish(HEADER, appended(robot), None, 10)
    stored = robot.folder.read()
    assert stored is not None
    assert stored.content.objects is None


def stored_objects(robot: Robot) -> ObjectMapState:
    stored = robot.folder.read()
    assert stored is not None
    assert stored.content.objects is not None
    return stored.content.objects


def test_a_dense_map_that_is_written_anew_is_not_lost_while_it_is_unknown(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, '_SPARE_BYTES', 0)
    uids = np.sort(robot.copy.keyframes.uid[robot.copy.keyframes.indices()])
    submaps, exports = [submap(int(uids[0]), 0)], SubmapExports(CONFIG)
    for seed in range(3):  # most voxels on the disk are dead then
        export = exports.since(robot.writer.submaps_since, submaps, uids)
        robot.writer.finish(HEADER, appended(robot), export, 7)
        submaps[0].update(no_evidence(len(submaps[0])), surface(seed))
    before = robot.folder.read()
    assert robot.writer.submaps_since is None
    with pytest.raises(MapFileError, match='the last checkpoint is kept'):
        robot.writer.finish(HEADER, appended(robot), None, 8, keep_submaps=True)
    after = robot.folder.read()
    assert before is not None
    assert after is not None
    assert before.content.dense is not None
    assert after.content.dense is not None
    assert after.content.dense.digest() == before.content.dense.digest()


def appended(robot: Robot) -> KeyframeCopy:
    part = robot.writer.parts.copy()
    robot.writer.append(part)
    assert part.keyframes is not None
    return part.keyframes


# ---- kills and damage


def test_a_process_that_is_killed_at_any_write_leaves_a_complete_checkpoint(
    tmp_path: Path,
) -> None:
    for at in range(100):
        robot = Robot(tmp_path / str(at))
        robot.write()
        before = robot.stored(), 7
        change_points(robot)
        extend(robot, 8, 10)
        is_killed = killed(partial(robot.write, stamp_ns=8), at)
        after = robot.expected(), 8
        assert stamped(robot) in (before, after)
        if not is_killed:
            break
    assert stamped(robot) == after
    assert at > 8


def test_after_a_kill_the_next_writer_leaves_no_remains(tmp_path: Path) -> None:
    for at in (1, 9, 11):
        robot = Robot(tmp_path)
        robot.write()
        extend(robot, 8, 10)
        assert killed(robot.write, at)
        other = Robot(tmp_path)
        other.write()
        assert other.stored() == other.expected()
        used = {'index', *(segment.path.name for segment in other.writer._segments.values())}
        assert {path.name for path in other.folder.path.iterdir()} <= used


class KilledError(BaseException):
    """The process would not exist any more."""


def killed(function: Callable[[], object], at: int) -> bool:
    """Run a function, of which only the first `at` changes of files take effect.

    Half of the bytes of the next write are written, as by a process that is killed in it. Returns
    whether the function was "killed".
    """
    count = 0

    def counted(call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapper(*arguments: Any, **options: Any) -> Any:
            nonlocal count
            count += 1
            if count <= at:
                return call(*arguments, **options)
            if call is pwrite and count == at + 1:
                descriptor, data, start = arguments
                pwrite(descriptor, data[: len(data) // 2], start)
            raise KilledError

        return wrapper

    pwrite = os.pwrite
    system = [(os, name) for name in ('pwrite', 'fsync', 'utime')]
    with pytest.MonkeyPatch.context() as patch, suppress(KilledError):
        for owner, name in (*system, (Path, 'replace'), (Path, 'unlink')):
            patch.setattr(owner, name, counted(getattr(owner, name)))
        function()
        return False
    return True


@pytest.mark.parametrize('name', ['index', 'features', 'states', 'points'])
def test_a_damaged_checkpoint_is_refused_in_one_line(robot: Robot, name: str) -> None:
    robot.write()
    (path,) = robot.folder.path.glob(f'{name}*')
    data = path.read_bytes()
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 0x10
    for damaged in (data[: len(data) // 2], b'', bytes(flipped)):
        path.write_bytes(damaged)
        with pytest.raises(MapFileError, match=r'^[^\n]*\.checkpoint-robot/index: [^\n]*$'):
            robot.folder.read()
    path.unlink()
    if name != 'index':
        with pytest.raises(MapFileError, match='cannot be read'):
            robot.folder.read()


def test_a_full_disk_keeps_the_checkpoint_and_the_next_one_continues(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.write()
    before = robot.stored()
    extend(robot, 8, 12)
    pwrite, calls = os.pwrite, 0

    def full(descriptor: int, data: memoryview, start: int) -> int:
        nonlocal calls
        calls += 1
        if calls > 3:
            raise OSError(28, 'No space left on device')
        return pwrite(descriptor, data, start)

    with monkeypatch.context() as patch:
        patch.setattr(os, 'pwrite', full)
        with pytest.raises(MapFileError, match='cannot be written: No space left'):
            robot.write()
    assert robot.stored() == before
    robot.write()
    assert robot.stored() == robot.expected()


def test_after_a_failed_sync_everything_is_written_again(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.write()
    names = set(segment_sizes(robot))
    extend(robot, 8, 12)

    def broken(_descriptor: int) -> None:
        raise OSError(5, 'Input/output error')

    with monkeypatch.context() as patch:
        patch.setattr(os, 'fsync', broken)
        with pytest.raises(MapFileError, match='Input/output error'):
            robot.write()
    robot.write()
    assert robot.stored() == robot.expected()
    assert not names & set(segment_sizes(robot))


def test_between_checkpoints_no_file_is_open(robot: Robot) -> None:
    """Otherwise, the disk could not be made read-only."""
    robot.write()
    change_points(robot)
    robot.write()
    links = (Path(f'/proc/self/fd/{n}') for n in range(3, 200))
    opened = [link.readlink() for link in links if link.is_symlink()]
    assert not [path for path in opened if path.parent == robot.folder.path]
    assert robot.stored() == robot.expected()


def test_after_somebody_has_deleted_the_files_everything_is_written_again(robot: Robot) -> None:
    robot.write()
    shutil.rmtree(robot.folder.path)
    change_points(robot)
    with pytest.raises(MapFileError, match=re.escape(str(robot.folder.path))):
        robot.write()
    robot.write()
    assert robot.stored() == robot.expected()


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    robot = Robot(tmp_path / 'file')
    with pytest.raises(MapFileError, match='cannot be written: Not a directory'):
        robot.write()


def test_a_kept_map_is_a_saved_map_and_no_checkpoint(robot: Robot) -> None:
    assert robot.folder.keep() == ''
    paths = []
    for is_copy in (True, True, False):
        robot.write()
        before = robot.stored()
        assert robot.folder.keep(is_copy=is_copy).startswith('map of ')
        (path,) = set(robot.folder.path.parent.glob('kept-*.hoidmap')) - set(paths)
        assert checkpoint_folder.load_map(path).map.digest() == before
        assert (robot.folder.read() is not None) == is_copy
        paths.append(path)
    assert not robot.folder.path.exists()


def test_a_copy_that_is_kept_already_is_not_kept_again(robot: Robot) -> None:
    robot.write()
    assert robot.folder.keep(is_copy=True)
    assert robot.folder.keep(is_copy=True) == ''
    kept = next(robot.folder.path.parent.glob('kept-*.hoidmap'))
    before = checkpoint_folder.load_map(kept).map.digest()
    extend(robot, 8, 10)
    Robot(robot.folder.path.parent, 5).write()  # another map replaces the checkpoint
    assert checkpoint_folder.load_map(kept).map.digest() == before


def test_the_file_of_an_earlier_version_is_found_and_not_read(robot: Robot) -> None:
    assert robot.folder.outdated() == ''
    old = robot.folder.path.with_name('.checkpoint-robot.hoidmap')
    old.write_bytes(b'old')
    assert str(old) in robot.folder.outdated()
    assert robot.folder.read() is None
    robot.write()
    assert old.read_bytes() == b'old'


def segment_sizes(robot: Robot) -> dict[str, int]:
    """Return the sizes of the segments on the disk by file name."""
    files = robot.folder.path.iterdir()
    return {path.name: path.stat().st_size for path in files if path.name != 'index'}


def stamped(robot: Robot) -> tuple[str | None, int]:
    """Return the digest of the map in the checkpoint, and the stamp of the last image in it."""
    checkpoint = robot.folder.read()
    assert checkpoint is not None
    return robot.stored(), checkpoint.stamp_ns
