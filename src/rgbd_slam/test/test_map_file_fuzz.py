"""Map files with damaged bytes are refused in one line, or give the map that was saved."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hoid_common.errors import MapFileError
from rgbd_slam.map_io import map_file
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.model.map_state import restore, snapshot

from .map_content import content, members_of, new_map, saved
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
    """Check that a file is refused in one line, or that its contents are those that were saved."""
    path.write_bytes(data)
    loaded = attempt(path)
    if loaded is None:
        return
    good = content()
    assert loaded.camera == good.camera
    assert loaded.map.digest() == good.map.digest()


_FUZZ = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


@_FUZZ
@given(data=st.data())
def test_flipped_bytes_never_do_harm(path: Path, data: st.DataObject) -> None:
    damaged = bytearray(saved())
    places = st.integers(0, len(damaged) - 1) | st.integers(len(damaged) - 2500, len(damaged) - 1)
    for at in data.draw(st.lists(places, min_size=1, max_size=4)):
        damaged[at] = data.draw(st.integers(0, 255))
    harmless(path, bytes(damaged))


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=6,
)


@pytest.mark.slow
@_FUZZ
@given(data=st.data())
def test_no_manifest_does_harm(path: Path, data: st.DataObject) -> None:
    """A manifest with a changed or missing value at any depth is refused in one line."""
    members = members_of(saved())
    manifest = json.loads(members['manifest.json'])
    at, key = manifest, data.draw(st.sampled_from(sorted(manifest)))
    while isinstance(at[key], dict) and data.draw(st.booleans()):
        at = at[key]
        key = data.draw(st.sampled_from(sorted(at)))
    at[key] = data.draw(_JSON)
    if data.draw(st.integers(0, 5)) == 0:
        del at[key]
    members['manifest.json'] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_STORED) as archive:
        for member, array in members.items():
            archive.writestr(member, array)
    attempt(path)


@_FUZZ
@given(document=_JSON)
def test_no_document_in_place_of_the_manifest_does_harm(path: Path, document: object) -> None:
    with zipfile.ZipFile(path, 'w') as archive:
        archive.writestr('manifest.json', json.dumps(document))
    assert attempt(path) is None


@_FUZZ
@given(end=st.integers(0, 2**30))
def test_truncated_files_never_do_harm(path: Path, end: int) -> None:
    harmless(path, saved()[: end % len(saved())])


@pytest.mark.slow
@_FUZZ
@given(
    name=st.sampled_from(sorted(members_of(saved()))), at=st.integers(0, 2**20),
    value=st.binary(min_size=1, max_size=16),
)  # fmt: skip
def test_forged_bytes_make_a_map_or_an_error(path: Path, name: str, at: int, value: bytes) -> None:
    members = members_of(saved())
    array = members[name]
    start = at % max(len(array) - len(value), 1)
    members[name] = array[:start] + value + array[start + len(value) :]
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_STORED) as archive:
        for member, array in members.items():
            archive.writestr(member, array)
    loaded = attempt(path)
    if loaded is None:
        return
    atlas = new_map()
    restore(atlas, loaded.map, CAMERA, keep=False)
    assert snapshot(atlas).digest() == loaded.map.digest()
    assert np.isfinite(atlas.points.view_direction).all()
