"""Foreign, damaged and hostile map files are refused in one clear line and do no harm."""

from __future__ import annotations

import json
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_common.errors import MapFileError
from hoid_scene.dense.dense_state import DenseState
from rgbd_slam.map_io import map_file
from rgbd_slam.model.map_state import MapState, snapshot

from .map_content import Members, content, members_of, new_map, ring, saved, write


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
    refused(tmp_path / 'none', 'there is no such file')
    refused(tmp_path, 'there is no such file')


@pytest.mark.parametrize(
    'data',
    [
        b'',
        b'\0' * 100,
        b'PK\x05\x06' + b'\0' * 18,
        pickle.dumps({'a': 1}),
        b'solid cube\nendsolid',
    ],
    ids=['empty', 'zeros', 'empty zip', 'pickle', 'text'],
)
def test_foreign_files_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / 'a').write_bytes(data)
    refused(tmp_path / 'a', 'no map file')


Manifest = dict[str, Any]


def forge(path: Path, change: Callable[[Members, Manifest], object], **kwargs: Any) -> None:
    """Write a map file with changed contents and correct checksums."""
    members = members_of(saved())
    manifest = json.loads(members['manifest.json'])
    change(members, manifest)
    if 'manifest.json' in members:
        members['manifest.json'] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, 'w', **{'compression': zipfile.ZIP_DEFLATED, **kwargs}) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def test_a_forged_file_without_changes_is_read(path: Path) -> None:
    forge(path, lambda _members, _manifest: None)
    assert map_file.load(path).map.digest() == content().map.digest()


FORGERIES: dict[str, tuple[str, Callable[[Members, Manifest], object]]] = {
    'another format': ('something else', lambda _, m: m.update(format='cat pictures')),
    'a later version': ('of version 2', lambda _, m: m.update(version=2)),
    'no version': ('of version None', lambda _, m: m.pop('version')),
    'no manifest': ('no manifest', lambda f, _: f.pop('manifest.json')),
    'a huge manifest': ('no manifest', lambda _, m: m.update(note='x' * 20_000)),
    'no lengths': ('damaged', lambda _, m: m.pop('lengths')),
    'no map': ('damaged', lambda _, m: m['lengths'].pop('map')),
    'an unknown section': ('damaged', lambda _, m: m['lengths'].update(extra={})),
    'a missing array': ('incomplete', lambda f, _: f.pop('map/point.npy')),
    'a foreign member': ('foreign', lambda f, _: f.update({'../../evil.sh': b'#!/bin/sh'})),
    'a huge length': ('another size', lambda _, m: m['lengths']['map'].update(points=2**30)),
    'an absurd length': ('damaged', lambda _, m: m['lengths']['map'].update(points=2**70)),
    'a negative length': ('damaged', lambda _, m: m['lengths']['map'].update(points=-1)),
    'a length of text': ('damaged', lambda _, m: m['lengths']['map'].update(points='9')),
    'a missing length': ('damaged', lambda _, m: m['lengths']['map'].pop('points')),
    'a camera of text': ('damaged', lambda _, m: m['camera'].update(fx_px='wide')),
    'a flat camera': ('focal lengths', lambda _, m: m['camera'].update(fx_px=0.0)),
    'a NaN camera': ('camera center must be', lambda _, m: m['camera'].update(cx_px=float('nan'))),
    'no camera': ('damaged', lambda _, m: m.pop('camera')),
    'a camera that is none': ('damaged', lambda _, m: m.update(camera=None)),
    'a camera that is a word': ('damaged', lambda _, m: m.update(camera='x')),
    'a camera with a secret': ('damaged', lambda _, m: m['camera'].update(zoom=2.0)),
    'lengths that are none': ('damaged', lambda _, m: m.update(lengths=None)),
    'lengths in a list': ('damaged', lambda _, m: m.update(lengths=[])),
    'a section of nothing': ('damaged', lambda _, m: m['lengths'].update(map=None)),
    'a true length': ('damaged', lambda _, m: m['lengths']['map'].update(points=True)),
    'no scale': ('damaged', lambda _, m: m.pop('scale_factor')),
    'octaves of text': ('damaged', lambda _, m: m.update(num_octaves='many')),
    'too few octaves': ('octave is out of range', lambda _, m: m.update(num_octaves=1)),
    'pickled objects': (
        'another type or shape',
        lambda f, _: f.update({'map/num_found.npy': pickled(f['map/num_found.npy'])}),
    ),
    'another type': (
        'another type or shape',
        lambda f, _: f.update(
            {'map/num_found.npy': f['map/num_found.npy'].replace(b"'<i8'", b"'<f8'")}
        ),
    ),
    'no Boolean value': (
        'Boolean values',
        lambda f, _: f.update({'map/may_seed.npy': f['map/may_seed.npy'][:-1] + b'\x07'}),
    ),
}  # fmt: skip


def pickled(array: bytes) -> bytes:
    """An array of objects of the same size, whose pickle would run a command."""
    head = b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
    command = b"cos\nsystem\n(S'touch pwned'\ntR."
    return (head.ljust(127) + b'\n' + command).ljust(len(array), b'\0')


@pytest.mark.parametrize('name', FORGERIES)
def test_forged_files_are_refused(path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(path.parent)
    said, change = FORGERIES[name]
    forge(path, change)
    refused(path, said)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_a_bomb_is_refused_before_it_is_unpacked(path: Path) -> None:
    def explode(members: Members, manifest: Manifest) -> None:
        count = 3_000_000
        manifest['lengths']['map']['points'] = count
        members['map/num_found.npy'] = bytes(128 + 8 * count)

    forge(path, explode)
    refused(path, 'unpacks to .* more than any map')


def test_a_member_twice_is_refused(path: Path) -> None:
    with zipfile.ZipFile(path, 'a') as archive, pytest.warns(UserWarning, match='Duplicate'):
        archive.writestr('map/point.npy', b'')
    refused(path, 'is incomplete, or has foreign parts')


@pytest.mark.parametrize('way', [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_members_packed_otherwise_are_refused(path: Path, way: int) -> None:
    forge(path, lambda _members, _manifest: None, compression=way)
    refused(path, 'compressed by an unknown method')
    data = bytearray(path.read_bytes())
    data[100:140] = bytes(40)  # of the compressed manifest, which must not be unpacked
    path.write_bytes(bytes(data))
    refused(path, 'compressed by an unknown method')


def changed(name: str, row: Any, value: Any) -> MapState:
    state = content().map
    array = getattr(state, name).copy()
    array[row] = value
    return replace(state, **{name: array})


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
    write(path, content()._replace(map=make()))
    refused(path, said)


def test_maps_that_share_a_point_are_refused(path: Path) -> None:
    atlas = ring(5, 1, ring(5))
    state = snapshot(atlas)
    first = np.flatnonzero(state.map_id[state.keyframe] == 1)
    point = state.point.copy()
    point[first[point[first] >= 0][0]] = 0
    point[point >= 0] = np.unique(point[point >= 0], return_inverse=True)[1]
    kept = np.unique(state.point[state.point >= 0])
    assert len(kept) == len(state.position_m)
    write(path, content()._replace(map=replace(state, point=point), dense=None))
    refused(path, 'two maps share a point|observed by no keyframe')


def test_two_maps_in_one_file_are_fine(path: Path) -> None:
    state = snapshot(ring(5, 1, ring(5)))
    map_file.save(path, content()._replace(map=state, dense=None))
    assert map_file.load(path).map.map_id.tolist() == [0] * 5 + [1] * 5


def test_an_empty_map_is_refused(path: Path) -> None:
    empty = content()._replace(map=snapshot(new_map()), dense=None)
    with pytest.raises(MapFileError, match='no keyframes'):
        map_file.save(path, empty)
    assert path.read_bytes() == saved()
    write(path, empty)
    refused(path, 'no keyframes')


@pytest.mark.parametrize(
    ('name', 'value', 'said'),
    [
        ('keyframe', 99, 'has no keyframe'),
        ('keyframe', -1, 'has no keyframe'),
        ('T_keyframe_camera', NAN, "image's pose"),
    ],
)
def test_images_that_belong_nowhere_are_refused(
    path: Path, name: str, value: float, said: str
) -> None:
    dense = content().dense
    assert dense is not None
    array = getattr(dense, name).copy()
    array[1] = value
    write(path, content()._replace(dense=replace(dense, **{name: array})))
    refused(path, said)


def test_images_of_two_sizes_are_refused(path: Path) -> None:
    dense = content().dense
    assert isinstance(dense, DenseState)
    other = replace(dense, image_bgr=np.ascontiguousarray(dense.image_bgr[:, :4]))
    write(path, content()._replace(dense=other))
    refused(path, 'differ in size')


OBJECT_FAULTS: dict[str, tuple[str, dict[str, Any]]] = {
    'number': ("object's number is invalid", {'object_id': np.array([1, 99])}),
    'numbers': ('same number', {'object_id': np.array([1, 1])}),
    'anchor': ('no keyframe', {'anchor': np.array([0, 900], np.int32)}),
    'pose': ('pose is invalid', {'T_anchor_object': np.full((2, 4, 4), np.nan)}),
    'state': ('state is unknown', {'state': np.array([0, 4], np.uint8)}),
    'sightings': ('num_sightings', {'num_sightings': np.array([4, 0])}),
    'stamp': ('stamp is out of range', {'last_ns': np.array([-1, 0])}),
    'probability': ('probability', {'probability': np.array([0.5, np.nan])}),
    'direction': ('invalid vector', {'direction_m': np.full((2, 3), np.inf)}),
    'classes': ('do not add up', {'num_classes': np.array([1, 2], np.int32)}),
    'no class': ('no class', {'num_classes': np.array([0, 2], np.int32)}),
    'name': ('name of a class', {'class_name': np.full((2, 64), 255, np.uint8)}),
    'empty name': ('name of a class', {'class_name': np.zeros((2, 64), np.uint8)}),
    'line break': ('name of a class', {'class_name': np.full((2, 64), 10, np.uint8)}),
    'score': ('score is invalid', {'class_score': np.array([0.0, 1.0])}),
    'voxels': ('numbers of voxels', {'num_voxels': np.array([1, 1], np.int32)}),
}


@pytest.mark.parametrize('name', OBJECT_FAULTS)
def test_objects_that_break_a_rule_are_refused(path: Path, name: str) -> None:
    said, columns = OBJECT_FAULTS[name]
    objects = content().objects
    assert objects is not None
    write(path, content()._replace(objects=replace(objects, **columns)))
    refused(path, said)


def test_unsorted_or_far_voxels_of_objects_are_refused(path: Path) -> None:
    objects = content().objects
    assert objects is not None
    for key, said in ((objects.key[::-1].copy(), 'not sorted'), (objects.key - 2**30, 'too far')):
        write(path, content()._replace(objects=replace(objects, key=key)))
        refused(path, said)
    for name, said in (('readings', 'readings'), ('hits', 'evidence'), ('means_m', 'point of')):
        broken = np.full_like(getattr(objects, name), np.nan)
        write(path, content()._replace(objects=replace(objects, **{name: broken})))
        refused(path, said)
