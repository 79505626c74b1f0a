"""Map files with damaged bytes are refused in one line, or make a map that does no harm."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hoid_common.errors import MapFileError
from hoid_common.store.table import sealed
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile

from .map_content import new_map, saved
from .ring_world import CAMERA


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / 'room.hoidmap'
    path.write_bytes(saved())
    return path


def attempt(path: Path) -> MapFile | None:
    """Load a file; if it is refused, check that the error has one line."""
    try:
        return map_file.load(path)
    except MapFileError as error:
        said = str(error)
    assert '\n' not in said
    return None


def harmless(path: Path, data: bytes) -> None:
    """Check that a file is refused in one line, or that its contents make a map.

    Only arrays have checksums, so that another changed number may be read.
    """
    path.write_bytes(data)
    loaded = attempt(path)
    if loaded is None:
        return
    map_file.check(loaded)
    atlas = new_map()
    restore(atlas, loaded.map, CAMERA, keep=False)
    assert snapshot(atlas).digest() == loaded.map.digest()


_FUZZ = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


@_FUZZ
@given(data=st.data())
def test_flipped_bytes_never_do_harm(path: Path, data: st.DataObject) -> None:
    damaged = bytearray(saved())
    places = st.integers(0, len(damaged) - 1) | st.integers(0, len(damaged) // 16_384 - 1).map(
        lambda page: 16_384 * page
    )
    for at in data.draw(st.lists(places, min_size=1, max_size=4)):
        damaged[at] = data.draw(st.integers(0, 255))
    harmless(path, bytes(damaged))


@_FUZZ
@given(end=st.integers(0, 2**30))
def test_truncated_files_never_do_harm(path: Path, end: int) -> None:
    harmless(path, saved()[: end % len(saved())])


_BLOBS = {'features': 'features', 'states': 'states', 'points': 'points', 'meta': 'camera'}


@pytest.mark.slow
@_FUZZ
@given(
    table=st.sampled_from(sorted(_BLOBS)), row=st.integers(0, 50), at=st.integers(0, 2**20),
    value=st.binary(min_size=1, max_size=16),
)  # fmt: skip
def test_forged_bytes_make_a_map_or_an_error(
    path: Path, table: str, row: int, at: int, value: bytes
) -> None:
    path.write_bytes(saved())
    column = _BLOBS[table]
    with closing(sqlite3.connect(path)) as connection:
        rows = connection.execute(f'SELECT rowid, {column} FROM {table}').fetchall()  # noqa: S608
        key, data = rows[row % len(rows)]
        start = 8 + at % max(len(data) - len(value) - 8, 1)
        forged = sealed(data[8:start] + value + data[start + len(value) :])
        sql = f'UPDATE {table} SET {column} = ? WHERE rowid = ?'  # noqa: S608
        connection.execute(sql, (forged, key))
        connection.commit()
    loaded = attempt(path)
    if loaded is None:
        return
    atlas = new_map()
    restore(atlas, loaded.map, CAMERA, keep=False)
    assert snapshot(atlas).digest() == loaded.map.digest()
    assert np.isfinite(atlas.points.view_direction).all()
