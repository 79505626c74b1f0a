"""A map that was saved and loaded is equal to the original, and behaves like it."""

from __future__ import annotations

import os
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import InputError, MapFileError
from hoid_common.store.database import replaced
from hoid_common.store.map_directory import remove_abandoned
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.store import map_file

from .map_content import OCTAVES, SCALE, content, new_map, ring, saved
from .ring_world import CAMERA


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / 'room.hoidmap'
    path.write_bytes(saved())
    return path


def test_what_is_saved_comes_back(tmp_path: Path) -> None:
    before = content()
    size = map_file.save(tmp_path / 'a', before)
    assert size == (tmp_path / 'a').stat().st_size
    after = map_file.load(tmp_path / 'a')
    assert after.camera == before.camera
    assert (after.scale_factor, after.num_octaves) == (SCALE, OCTAVES)
    assert after.map.digest() == before.map.digest()
    np.testing.assert_array_equal(after.uids, before.uids)
    assert (after.session, after.stamp_ns) == ('today', 123)
    for edge, stored in zip(before.loops, after.loops, strict=True):
        for value, read in zip(edge, stored, strict=True):
            np.testing.assert_array_equal(value, read)
    assert [p.name for p in tmp_path.iterdir()] == ['a']


def test_users_can_look_into_a_map_file_with_sqlite(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection:
        rows = connection.execute('SELECT uid, stamp_ns FROM keyframes ORDER BY uid').fetchall()
    assert [uid for uid, _ in rows] == np.asarray(content().uids).tolist()
    assert [stamp_ns for _, stamp_ns in rows] == content().map.stamp_ns.tolist()


def test_a_restored_map_is_the_one_that_was_saved() -> None:
    running = ring()
    state = snapshot(running)
    copy = new_map()
    restore(copy, state, CAMERA, keep=False)
    assert snapshot(copy).digest() == state.digest()
    i, j = running.keyframes.indices(), running.points.indices()
    np.testing.assert_allclose(
        copy.keyframes.measurement_px[i], running.keyframes.measurement_px[i], atol=1e-3
    )
    for name in ('num_observations', 'num_stereo', 'descriptors'):
        np.testing.assert_array_equal(
            getattr(copy.points, name)[j], getattr(running.points, name)[j]
        )
    for name in ('view_direction', 'max_distance_m', 'min_distance_m'):
        np.testing.assert_allclose(
            getattr(copy.points, name)[j], getattr(running.points, name)[j], rtol=1e-6
        )
    for n in i.tolist():
        running.update_connections(n)
    np.testing.assert_array_equal(np.stack(copy.graph.edges()), np.stack(running.graph.edges()))
    assert copy.keyframes.is_loaded[i].all()


def test_a_map_that_lost_keyframes_and_points_is_saved_whole() -> None:
    running = ring()
    for n in (3, 5):
        running.remove_keyframe(n)
    running.remove_points(running.points.indices()[::3])
    copy = new_map()
    restore(copy, snapshot(running), CAMERA, keep=False)
    assert len(copy.keyframes) == 6
    assert len(copy.points) == len(running.points)
    assert snapshot(copy).digest() == snapshot(running).digest()


def test_a_point_whose_reference_has_lost_it_is_saved_with_another() -> None:
    atlas = ring()
    seen = atlas.observations_of(atlas.points.indices())
    shared = np.flatnonzero(atlas.points.num_observations[seen.j] > 1)
    is_reference = atlas.keyframes.uid[seen.i] == atlas.points.reference_keyframe_uid[seen.j]
    n = shared[is_reference[shared]][0]
    atlas.unobserve(int(seen.i[n]), seen.k[n : n + 1])
    state = snapshot(atlas)
    sees = state.keyframe == state.reference[state.point]
    assert np.isin(np.arange(len(state.position_m)), state.point[sees]).all()
    again = new_map()
    restore(again, state, CAMERA, keep=False)
    assert snapshot(again).digest() == state.digest()


def test_restoring_replaces_the_running_map() -> None:
    state, running = snapshot(ring(5)), ring(8)
    gone = running.keyframes.uid[running.keyframes.indices()]
    restore(running, state, CAMERA, keep=False)
    assert snapshot(running).digest() == state.digest()
    assert not np.isin(gone, running.keyframes.uid).any()


def test_a_map_that_is_kept_is_the_younger_one() -> None:
    state, running = snapshot(ring(5)), ring(8)
    before = snapshot(running)
    restore(running, state, CAMERA, keep=True)
    kf = running.keyframes
    assert np.bincount(kf.map_id[kf.indices()]).tolist() == [5, 8]
    assert not kf.is_loaded[kf.alive & (kf.map_id == 1)].any()
    assert kf.is_loaded[kf.alive & (kf.map_id == 0)].all()
    both = snapshot(running)
    np.testing.assert_array_equal(both.map_id, [1] * 8 + [0] * 5)
    np.testing.assert_array_equal(both.T_map_camera[:8], before.T_map_camera)


def test_changes_by_restoring_reach_a_copy() -> None:
    owner, copy = ring(8), new_map()
    first = owner.changes_since(0)
    copy.apply(first)
    restore(owner, snapshot(ring(5)), CAMERA, keep=False)
    copy.apply(owner.changes_since(first.version))
    assert snapshot(copy).digest() == snapshot(owner).digest()
    np.testing.assert_array_equal(np.stack(copy.graph.edges()), np.stack(owner.graph.edges()))
    np.testing.assert_array_equal(copy.points.view_direction, owner.points.view_direction)


def test_a_moved_map_keeps_what_its_keyframes_see() -> None:
    state, T = snapshot(ring()), se3.exp(np.array([0.3, -0.2, 0.9, 1.0, 2.0, 3.0]))
    moved = state.moved(T)
    before = se3.transform(se3.inverse(state.T_map_camera[2]), state.position_m)
    after = se3.transform(se3.inverse(moved.T_map_camera[2]), moved.position_m)
    np.testing.assert_allclose(after, before, atol=1e-12)
    np.testing.assert_allclose(
        moved.moved(se3.inverse(T)).position_m, state.position_m, atol=1e-12
    )


# ---- writing


def test_a_file_that_cannot_be_written_leaves_the_old_one(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(MapFileError, match='cannot be written: No space left'):
        map_file.save(path, content())
    assert path.read_bytes() == saved()
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='cannot be written'):
        map_file.save(tmp_path / 'file' / 'a', content())


def test_remains_of_killed_processes_are_removed(tmp_path: Path) -> None:
    names = ('.map.partial-0a', '.partial.partial-0b', '.map.partial-0c', 'x.hoidmap')
    killed, scratch, young, foreign = (tmp_path / name for name in names)
    for folder in (killed, scratch, young, foreign):
        folder.mkdir()
        (folder / 'x').write_bytes(b'half')
    os.mkfifo(tmp_path / '.map.partial-pipe')
    an_hour_ago = time.time() - 3600
    with replaced(tmp_path / 'being written') as aside:
        aside.write_bytes(b'whole')
        for path in (killed, scratch, foreign, aside.parent):
            os.utime(path, (an_hour_ago, an_hour_ago))
        assert sorted(remove_abandoned(str(tmp_path))) == sorted([killed.name, scratch.name])
        assert not killed.exists()
        assert not scratch.exists()
        assert young.exists()
        assert aside.exists()
    assert foreign.exists()
    assert (tmp_path / 'being written').exists()
    assert remove_abandoned(str(tmp_path / 'nowhere')) == []
