"""What a map file says of itself: its camera, its features, and the lengths of its arrays."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from typing import NamedTuple, TypeGuard

from hoid_common.errors import MapFileError
from hoid_common.io.record import Record
from hoid_common.values import CameraModel
from rgbd_slam.model.map_state import MapState
from rgbd_slam.scene.dense_state import DenseState

VERSION = 1
FORMAT = 'hoid map'
MANIFEST = 'manifest.json'
SECTIONS: dict[str, type[Record]] = {'map': MapState, 'dense': DenseState}
MOST_DISTORTION = 14  # coefficients of OpenCV's models
_INTRINSICS = ('fx_px', 'fy_px', 'cx_px', 'cy_px')
_MOST_MANIFEST_BYTES = 10_000
_MOST_ROWS = 2**31


class Manifest(NamedTuple):
    """What a file says of itself."""

    camera: CameraModel
    scale_factor: float
    num_octaves: int
    lengths: dict[str, dict[str, int]]  # of the named axes, by section


def read_manifest(archive: zipfile.ZipFile, infos: Mapping[str, zipfile.ZipInfo]) -> Manifest:
    """Return the manifest of a map file of this version.

    Raises:
        MapFileError: It is of something else, of another version, or damaged.
    """
    if MANIFEST not in infos or infos[MANIFEST].file_size > _MOST_MANIFEST_BYTES:
        raise MapFileError('is no map file: it has no manifest')
    said = json.loads(archive.read(MANIFEST))
    if not isinstance(said, dict) or said.get('format') != FORMAT:
        raise MapFileError('is no map file: its manifest is of something else')
    if said.get('version') != VERSION:
        raise MapFileError(
            f'is of version {said.get("version")!r:.20}, and this program reads version '
            f'{VERSION}: save the map anew with the program that made it'
        )
    scale_factor, num_octaves = said.get('scale_factor'), said.get('num_octaves')
    if not _is_number(scale_factor) or not _is_count(num_octaves):
        raise MapFileError('is damaged: its manifest does not say which features it has')
    lengths = _lengths(said.get('lengths'))
    return Manifest(_camera(said.get('camera')), float(scale_factor), num_octaves, lengths)


def _camera(said: object) -> CameraModel:
    """Return the camera that a manifest speaks of."""
    names = {field.name for field in fields(CameraModel)}
    if not isinstance(said, dict) or said.keys() != names:
        raise MapFileError('is damaged: its manifest names no camera')
    size_px, distortion = (said['width_px'], said['height_px']), said['distortion']
    is_lens = isinstance(distortion, list) and len(distortion) <= MOST_DISTORTION
    numbers = [said[name] for name in _INTRINSICS]
    is_camera = is_lens and all(map(_is_number, (*numbers, *distortion)))
    if not is_camera or not all(map(_is_count, size_px)):
        raise MapFileError('is damaged: the camera in its manifest is none')
    fx_px, fy_px, cx_px, cy_px = numbers
    return CameraModel(*size_px, fx_px, fy_px, cx_px, cy_px, tuple(distortion))


def _lengths(said: object) -> dict[str, dict[str, int]]:
    """Return the lengths of the axes of each section that a manifest speaks of."""
    if not isinstance(said, dict) or not said.keys() <= SECTIONS.keys():
        raise MapFileError('is damaged: its manifest does not say what it holds')
    if 'map' not in said:
        raise MapFileError('holds no map')
    for name, lengths in said.items():
        axes = {a for c in SECTIONS[name].columns().values() for a in c.axes if isinstance(a, str)}
        is_table = isinstance(lengths, dict) and lengths.keys() == axes
        if not is_table or not all(map(_is_count, lengths.values())):
            raise MapFileError(f'the lengths of section "{name}" are none')
    return said


def _is_number(value: object) -> TypeGuard[float]:
    return type(value) in (int, float)  # truth values are none


def _is_count(value: object) -> TypeGuard[int]:
    return type(value) is int and 0 <= value < _MOST_ROWS
