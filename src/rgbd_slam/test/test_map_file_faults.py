"""Foreign, damaged and hostile map files are refused in one clear line and do no harm."""

from __future__ import annotations

import pickle
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_common.errors import MapFileError
from hoid_common.store.database import Database
from hoid_common.store.table import sealed
from rgbd_slam.model.map_state import MapState, snapshot
from rgbd_slam.store import map_file
from rgbd_slam.store.tables import POINTS, PointRows

from .map_content import content, new_map, ring, saved, write


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / 'room.hoidmap'
    path.write_bytes(saved())
    return path


def refused(path: Path, message: str) -> None:
    with pytest.raises(MapFileError, match=message) as caught:
        map_file.load(path)
    text = str(caught.value)
    assert str(path) in text
    assert '\n' not in text
    assert len(text) < 400


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    refused(tmp_path / 'none', 'no such file')
    refused(tmp_path, 'not a regular file|cannot be read')


@pytest.mark.parametrize(
    'data',
    [b'', b'\0' * 100, pickle.dumps({'a': 1}), b'solid cube\nendsolid'],
    ids=['empty', 'zeros', 'pickle', 'text'],
)
def test_foreign_files_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / 'a').write_bytes(data)
    refused(tmp_path / 'a', 'no map file')


def test_a_database_of_another_program_is_refused(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / 'a')) as connection:
        connection.execute('CREATE TABLE keyframes (uid INTEGER PRIMARY KEY)')
    refused(tmp_path / 'a', 'no map file')


_FLAT = sealed(bytes(64)).hex()
_LONG_FEATURES = "UPDATE features SET features = x'" + sealed(b'a' * 100_000).hex() + "'"  # noqa: S608
FORGERIES: dict[str, tuple[str, str]] = {
    'another version': ('of version 99', 'PRAGMA user_version = 99'),
    'another program': ('no map file', 'PRAGMA application_id = 1'),
    'no header': ('has no map', 'DELETE FROM meta'),
    'a header elsewhere': ('has no map', 'UPDATE meta SET id = 1'),
    'no camera': ('shorter than its lengths', "UPDATE meta SET camera = x''"),
    'a flat camera': (
        'camera size', f"UPDATE meta SET camera = x'{_FLAT}'"  # noqa: S608
    ),
    'too few octaves': ('octave is out of range', 'UPDATE meta SET num_octaves = 1'),
    'no table': ('has no map', 'DROP TABLE loops'),
    'no keyframe': ('not those of its keyframes', 'DELETE FROM keyframes WHERE uid = 10'),
    'no features': ('not those of its keyframes', 'DELETE FROM features WHERE uid = 10'),
    'no states': ('not those of its keyframes', 'DELETE FROM states WHERE uid = 10'),
    'no points': ('lacks a point', 'DELETE FROM points'),
    'other states': (
        'lacks features or their states',
        'UPDATE states SET states = (SELECT states FROM states WHERE uid = 7) WHERE uid = 10',
    ),
    'a negative number': ('negative', 'UPDATE keyframes SET uid = -5 WHERE uid = 10'),
    'a parent that is gone': ('not that of roots', 'UPDATE keyframes SET parent_uid = 8'),
    'other features': (
        'another checksum', "UPDATE features SET features = CAST(features || 'x' AS BLOB)"
    ),
    'features of a large size': (
        'does not have', _LONG_FEATURES
    ),
}  # fmt: skip


@pytest.mark.parametrize('name', FORGERIES)
def test_forged_files_are_refused(path: Path, name: str) -> None:
    said, statement = FORGERIES[name]
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(statement)
        connection.commit()
    refused(path, said)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ('rows', 'said'),
    [([-5], 'negative'), ([2**31 - 1], 'memory|reference does not exist')],
    ids=['negative', 'huge'],
)
def test_points_with_other_rows_are_refused(path: Path, rows: list[int], said: str) -> None:
    counts = np.zeros(1, np.int64)
    points = PointRows(np.array(rows, np.int32), np.zeros((1, 3)), counts, counts, counts)
    with Database.open(path, []) as database, database.transaction():
        database.put(POINTS, [(500_000, points)])
    refused(path, said)


def changed(name: str, row: Any, value: Any) -> MapState:
    state = content().map
    array = getattr(state, name).copy()
    array[row] = value
    return replace(state, **{name: array})


def only(state: MapState) -> map_file.MapFile:
    """Return the content of a file with this map alone."""
    return content()._replace(map=state, uids=None)


def blind() -> MapState:
    """Return a map with a point whose reference is a keyframe that does not see it."""
    state = content().map
    j = int(state.point[state.point >= 0][0])
    stranger = np.setdiff1d(np.arange(len(state)), state.keyframe[state.point == j])[0]
    return changed('reference', j, stranger)


def unseen() -> MapState:
    state = content().map
    return replace(state, point=np.where(state.point == 5, -1, state.point).astype(np.int32))


def at_camera() -> MapState:
    state = content().map
    k = int(np.flatnonzero(state.point >= 0)[0])
    at = state.T_map_camera[state.keyframe[k], :3, 3]
    return changed('position_m', int(state.point[k]), at)


NAN = float('nan')
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
MAPS: dict[str, tuple[str, Callable[[], MapState]]] = {
    'NaN pose': ("keyframe's pose", lambda: changed('T_map_camera', (1, 0, 3), NAN)),
    'far pose': ("keyframe's pose", lambda: changed('T_map_camera', (1, 0, 3), 1e30)),
    'mirrored pose': ("keyframe's pose", lambda: changed('T_map_camera', 1, MIRROR)),
    'scaled pose': ("keyframe's pose", lambda: changed('T_map_camera', 1, np.diag([2, 2, 2, 1]))),
    'projective pose': ("keyframe's pose", lambda: changed('T_map_camera', (1, 3, 0), 0.5)),
    'negative stamp': ('time stamp', lambda: changed('stamp_ns', 0, -1)),
    'late stamp': ('time stamp', lambda: changed('stamp_ns', 0, 2**62)),
    'feature counts': ('do not add up', lambda: changed('num_features', 2, 1)),
    'negative count': ('is negative', lambda: changed('num_features', 2, -5)),
    'huge count': ('do not add up', lambda: changed('num_features', 2, 2**31 - 1)),
    'parent outside': ('a parent does not exist', lambda: changed('parent', 3, 99)),
    'parent in a circle': ('form a circle', lambda: changed('parent', 3, 6)),
    'parent itself': ('form a circle', lambda: changed('parent', 3, 3)),
    'two roots': ('not that of roots', lambda: changed('parent', 3, -1)),
    'no root': ('no root', lambda: changed('map_id', 3, 7)),
    'negative map': ('no root', lambda: changed('map_id', 3, -2)),
    'NaN pixel': ('pixel', lambda: changed('uv_px', (9, 1), NAN)),
    'far pixel': ('pixel', lambda: changed('uv_px', (9, 0), 1e9)),
    'NaN depth': ('depth', lambda: changed('depth_m', 9, NAN)),
    'negative depth': ('depth', lambda: changed('depth_m', 9, -1.0)),
    'tiny depth': ('depth', lambda: changed('depth_m', 9, 1e-30)),
    'infinite depth': ('depth', lambda: changed('depth_m', 9, np.inf)),
    'octave': ('octave', lambda: changed('octave', 9, 200)),
    'NaN angle': ('angle', lambda: changed('angle_deg', 9, NAN)),
    'point outside': ('point that does not exist', lambda: changed('point', 9, 10**6)),
    'point below': ('point that does not exist', lambda: changed('point', 9, -2)),
    'point seen twice': ('one point twice', lambda: changed('point', slice(0, 2), 5)),
    'point never seen': ('observed by no keyframe', unseen),
    'NaN point': ('point is out of range', lambda: changed('position_m', (4, 2), NAN)),
    'point in the camera': ('lies in the camera', at_camera),
    'reference outside': ('reference', lambda: changed('reference', 4, 10**6)),
    'blind reference': ('not observed by its reference', blind),
    'negative found': ('count', lambda: changed('num_found', 4, -1)),
    'huge visible': ('count', lambda: changed('num_visible', 4, 2**60)),
}  # fmt: skip


@pytest.mark.parametrize('name', MAPS)
def test_arrays_that_make_no_map_are_refused(path: Path, name: str) -> None:
    said, make = MAPS[name]
    with pytest.raises(MapFileError, match=said):
        map_file.save(path, only(make()))
    assert path.read_bytes() == saved()


def test_maps_that_share_a_point_are_refused(path: Path) -> None:
    atlas = ring(5, 1, ring(5))
    state = snapshot(atlas)
    first = np.flatnonzero(state.map_id[state.keyframe] == 1)
    point = state.point.copy()
    point[first[point[first] >= 0][0]] = 0
    point[point >= 0] = np.unique(point[point >= 0], return_inverse=True)[1]
    kept = np.unique(state.point[state.point >= 0])
    assert len(kept) == len(state.position_m)
    write(path, only(replace(state, point=point)))
    refused(path, 'two maps share a point|observed by no keyframe')


def test_two_maps_in_one_file_are_fine(path: Path) -> None:
    state = snapshot(ring(5, 1, ring(5)))
    map_file.save(path, only(state))
    assert map_file.load(path).map.map_id.tolist() == [0] * 5 + [1] * 5


def test_an_empty_map_is_refused(path: Path) -> None:
    empty = only(snapshot(new_map()))
    with pytest.raises(MapFileError, match='no keyframes'):
        map_file.save(path, empty)
    assert path.read_bytes() == saved()
    write(path, empty)
    refused(path, 'no keyframes')
