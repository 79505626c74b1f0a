"""A whole map in one file: a zip of NumPy arrays with a manifest, which `numpy.load` opens too.

The type and shape of every array follow from the schema (`Record`) and the lengths in the
manifest. They are checked before an array is unpacked, and nothing in a file is ever executed.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import struct
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from hoid_common.errors import HoidError, MapFileError
from hoid_common.values import CameraModel, FloatArray
from rgbd_slam.dense.submap_state import DenseMap, SubmapState
from rgbd_slam.map_io.manifest import (
    FORMAT,
    MANIFEST,
    MAX_DISTORTION,
    SECTIONS,
    VERSION,
    read_manifest,
)
from rgbd_slam.map_io.map_check import check_dense, check_map, check_submaps
from rgbd_slam.model.map_state import MapState
from rgbd_slam.records.record import Array, Column, Record

SUFFIX = '.hoidmap'
_HEADER_BYTES = 128
_SAME = 1e-6  # chosen: intrinsics [px] that differ by less are equal
_MAX_ZOOM = 1.1  # chosen: ratio of focal lengths up to which a camera extends the map of another
# Protection from zip bombs: a map unpacks to about twice the size of its file.
_MAX_EXPANSION = 50
_SMALL_BYTES = 1_000_000  # chosen: so many unpacked bytes are harmless in any case
_MAX_QUOTED = 120  # chosen: characters of an error, which may quote the file
_PIECE_BYTES = 1 << 20  # arrays are written piecewise
# The errors that zipfile, zlib, json and NumPy raise for damaged files.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    NotImplementedError,
    RuntimeError,
    OverflowError,
)


class MapFile(NamedTuple):
    """The contents of a map file; poses are in the published map frame, with z up."""

    camera: CameraModel  # that the map was made with
    scale_factor: float  # ratio of the scales of two successive octaves
    num_octaves: int
    map: MapState
    dense: DenseMap | None = None

    def seen_by(
        self, camera: CameraModel, scale_factor: float, num_octaves: int, *, extend: bool
    ) -> MapFile:
        """Return the map as if it had been made with a given camera.

        Its features lie at undistorted pixels, so that they are moved to those of the same rays.

        Args:
            camera: The camera.
            scale_factor: Ratio of the sizes of two successive octaves of its features.
            num_octaves: Number of octaves of its features.
            extend: Whether the camera will extend the map, and not only be localized in it. Then
                its focal length must be similar, because features of the two are matched in both
                directions.

        Raises:
            MapFileError: The map has other octaves, or the focal lengths differ too much.
        """
        if (self.scale_factor, self.num_octaves) != (scale_factor, num_octaves):
            raise MapFileError(
                f'the map has features of {self.num_octaves} octaves with scale '
                f'{self.scale_factor:g}: set camera.num_octaves and camera.scale_factor to these'
            )
        if self._is_of(camera):
            return self
        if extend:
            check_extendable(self.camera, camera)
        state = self.map.in_camera(self.camera, camera, scale_factor, num_octaves)
        return self._replace(camera=camera, map=state)

    def _is_of(self, camera: CameraModel) -> bool:
        """Return whether a camera is that of the map."""
        is_size = _size_px(self.camera) == _size_px(camera)
        return is_size and bool(
            (np.abs(_intrinsics(camera) - _intrinsics(self.camera)) < _SAME).all()
        )


def check_extendable(made_with: CameraModel, camera: CameraModel) -> None:
    """Raise MapFileError if a camera differs too much from that of a map to extend the map."""
    zoom = np.sqrt(camera.fx_px * camera.fy_px / made_with.fx_px / made_with.fy_px)
    if abs(np.log(zoom)) > np.log(_MAX_ZOOM):
        raise MapFileError(
            f'the map was made with another camera, {_listed(made_with)}, and this one, '
            f'{_listed(camera)}, differs too much to extend it: localize in it (mode '
            'localization, ./hoid run --localize), or make a new map'
        )


def _size_px(camera: CameraModel) -> tuple[int, int]:
    return camera.width_px, camera.height_px


def _intrinsics(camera: CameraModel) -> FloatArray:
    out = np.zeros(4 + MAX_DISTORTION)
    values = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
    out[: len(values)] = values
    return out


def _listed(camera: CameraModel) -> str:
    return f'{camera.width_px}x{camera.height_px} with fx={camera.fx_px:g} fy={camera.fy_px:g}'


def save(path: Path, content: MapFile) -> int:
    """Write a map file and return its size in bytes.

    An existing file is replaced once the new one is completely on the disk.

    Raises:
        MapFileError: The file cannot be written, or could not be loaded; an existing file is
            unchanged.
    """
    _check(content)
    aside = path.with_name(f'.partial-{secrets.token_hex(4)}-{path.name}')
    try:
        try:
            with aside.open('xb') as file:
                _write(file, content)
                file.flush()
                os.fsync(file.fileno())
                size = file.tell()
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)
        _sync_folder(path.parent)
    except OSError as error:
        raise MapFileError(f'{path}: cannot be written: {error.strerror}') from error
    return size


def load(path: Path) -> MapFile:
    """Return the contents of a map file, after checking them.

    Raises:
        MapFileError: The file does not exist, is no map file of this version, or is damaged.
    """
    if not path.is_file():  # also refuses pipes, whose opening would wait
        raise MapFileError(f'{path}: there is no such file')
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(archive, path.stat().st_size)
    except HoidError as error:
        raise MapFileError(f'{path}: {error}') from error
    except MemoryError as error:
        raise MapFileError(f'{path}: does not fit into memory') from error
    except OSError as error:
        raise MapFileError(f'{path}: cannot be read: {error.strerror}') from error
    except _DAMAGE as error:
        text = ' '.join(str(error).split())[:_MAX_QUOTED]
        raise MapFileError(f'{path}: is no map file, or is damaged: {text}') from error


def _write(file: IO[bytes], content: MapFile) -> None:
    records = [record for record in (content.map, content.dense) if record is not None]
    present = {_section_of(record): record for record in records}
    manifest = {
        'format': FORMAT,
        'version': VERSION,
        'camera': asdict(content.camera),
        'scale_factor': content.scale_factor,
        'num_octaves': content.num_octaves,
        'lengths': {name: record.lengths() for name, record in present.items()},
    }
    # Not compressed: that saved 18 % of a map without images and took ten times as long.
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_STORED) as archive:
        archive.writestr(MANIFEST, json.dumps(manifest, indent=1))
        for section, record in present.items():
            for name, array in record.arrays().items():
                column, lengths = record.columns()[name], record.lengths()
                with archive.open(_member(section, name), 'w', force_zip64=True) as member:
                    member.write(_header(column, lengths))
                    data = array.reshape(-1).view(np.uint8).data
                    for start in range(0, len(data), _PIECE_BYTES):
                        member.write(data[start : start + _PIECE_BYTES])


def _sync_folder(folder: Path) -> None:
    """Make the renaming of a file permanent on the disk, if the file system supports that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _member(section: str, name: str) -> str:
    return f'{section}/{name}.npy'


def _header(column: Column, lengths: Mapping[str, int]) -> bytes:
    """Return the only accepted header of an array's file (NPY format 1.0)."""
    shape = column.shape(lengths)
    text = f"{{'descr': {column.dtype.str!r}, 'fortran_order': False, 'shape': {shape}, }}"
    return struct.pack('<6sBBH', b'\x93NUMPY', 1, 0, _HEADER_BYTES - 10) + (
        text.ljust(_HEADER_BYTES - 11).encode() + b'\n'
    )


def _read(archive: zipfile.ZipFile, file_bytes: int) -> MapFile:
    infos = {info.filename: info for info in archive.infolist()}
    for name, info in infos.items():  # before anything is unpacked
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise MapFileError(f'"{name:.40}" is compressed by an unknown method')
    manifest = read_manifest(archive, infos)
    unpacked = sum(info.file_size for info in archive.infolist())
    if unpacked > _SMALL_BYTES + _MAX_EXPANSION * file_bytes:
        raise MapFileError(f'unpacks to {unpacked} bytes, more than any map of this size')
    parts = manifest.lengths
    names = [_member(part, name) for part in parts for name in SECTIONS[part].columns()]
    if sorted(info.filename for info in archive.infolist()) != sorted([*names, MANIFEST]):
        raise MapFileError('is incomplete, or has foreign parts')
    records = [_section(archive, part, parts[part]) for part in SECTIONS if part in parts]
    content = MapFile(manifest.camera, manifest.scale_factor, manifest.num_octaves, *records)
    _check(content)
    return content


def _check(content: MapFile) -> None:
    with np.errstate(all='ignore'):  # NaN and infinity fail the checks
        check_map(content.map, content.camera, content.num_octaves)
        if isinstance(content.dense, SubmapState):
            check_submaps(content.dense, len(content.map))
        elif content.dense is not None:
            check_dense(content.dense, len(content.map))


def _section_of(record: Record) -> str:
    return next(name for name, kind in SECTIONS.items() if isinstance(record, kind))


def _section(archive: zipfile.ZipFile, section: str, lengths: Mapping[str, int]) -> Any:
    record = SECTIONS[section]
    return record.of(
        {
            name: _array(archive, _member(section, name), column, lengths)
            for name, column in record.columns().items()
        }
    )


def _array(
    archive: zipfile.ZipFile, name: str, column: Column, lengths: Mapping[str, int]
) -> Array:
    """Return one array of a file, read-only, after checking its size and header.

    Args:
        archive: The file.
        name: Name of the array's member in the file.
        column: The declared type and shape.
        lengths: Lengths of the named axes.
    """
    shape = column.shape(lengths)
    info = archive.getinfo(name)
    if info.file_size != _HEADER_BYTES + math.prod(shape) * column.dtype.itemsize:
        raise MapFileError(f'"{name}" has another size than its manifest requires')
    data = archive.read(info)
    if len(data) != info.file_size or data[:_HEADER_BYTES] != _header(column, lengths):
        raise MapFileError(f'"{name}" has another type or shape than its manifest requires')
    array: Array = np.frombuffer(data, column.dtype, offset=_HEADER_BYTES).reshape(shape)
    if column.dtype == np.bool_ and (array.view(np.uint8) > 1).any():
        raise MapFileError(f'"{name}" has Boolean values other than 0 and 1')
    return array
