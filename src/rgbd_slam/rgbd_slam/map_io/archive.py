"""Zip archives of NumPy arrays with a manifest, which `numpy.load` opens too.

The type and shape of every array follow from a declared `Record` and the lengths in the manifest.
The size of an array is checked before it is unpacked, and its type and shape before it is used.
Nothing in a file is ever executed.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import secrets
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from hoid_common.errors import HoidError, MapFileError
from hoid_common.io.records import Array, Column, Record

T = TypeVar('T')
R = TypeVar('R', bound=Record)

MANIFEST = 'manifest.json'
PARTIAL = '.partial-'  # first part of the name of a file that is being written
_HEADER_BYTES = 128
# Protection from zip bombs: a file is refused if it unpacks to more than _SMALL_BYTES plus this
# multiple of its size. Maps are not compressed; those of earlier versions unpack to about twice
# the size of their files.
_MAX_EXPANSION = 50
_SMALL_BYTES = 1_000_000  # chosen: so many unpacked bytes are harmless in any case
# Chosen: a manifest has less than 1 kB.
_MAX_MANIFEST_BYTES = 10_000
_MAX_QUOTED = 120  # chosen: characters of an error text that are shown; it may quote the file
_PIECE_BYTES = 1 << 20  # arrays are written piecewise
# The errors that zipfile, zlib, json and NumPy raise for damaged files.
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    ValueError,
    LookupError,
    TypeError,
    NotImplementedError,
    RuntimeError,
    OverflowError,
)


@contextmanager
def replaced(path: Path) -> Iterator[IO[bytes]]:
    """Yield a new binary file, which replaces `path` at the end of the block.

    It replaces `path` only after all its bytes are on the disk, and is removed if the block
    raises. If the file system has locks, it is locked while it is written: an unlocked one was
    left by a killed process (`abandoned_files`).

    Raises:
        MapFileError: The file cannot be written; an existing file is unchanged.
    """
    aside = path.with_name(f'{PARTIAL}{secrets.token_hex(4)}-{path.name}')
    try:
        try:
            with aside.open('xb') as file:
                with suppress(OSError):  # the file system has no locks
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                yield file
                file.flush()
                os.fsync(file.fileno())
                aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)
        sync_folder(path.parent)
    except OSError as error:
        raise MapFileError(f'{path}: cannot be written: {error.strerror}') from error


def sync_folder(folder: Path) -> None:
    """Write the entries of a folder to the disk, so that renamed files survive a power cut.

    Errors are ignored, because some file systems cannot do this.
    """
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write(file: IO[bytes], manifest: Mapping[str, Any], records: Mapping[str, Record]) -> None:
    """Write an archive.

    Args:
        file: A file that is open for writing.
        manifest: The manifest, to which the lengths of the records are added as `lengths`.
        records: The records, by the names of their sections in the archive.
    """
    lengths = {section: record.lengths() for section, record in records.items()}
    # Not compressed: that saved 18 % of a map without images and took ten times as long.
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_STORED) as archive:
        archive.writestr(MANIFEST, json.dumps({**manifest, 'lengths': lengths}, indent=1))
        for section, record in records.items():
            for name, array in record.arrays().items():
                with archive.open(_member(section, name), 'w', force_zip64=True) as member:
                    member.write(_header(record.columns()[name], lengths[section]))
                    data = array.reshape(-1).view(np.uint8).data
                    for start in range(0, len(data), _PIECE_BYTES):
                        member.write(data[start : start + _PIECE_BYTES])


def read(path: Path, read_content: Callable[[Reader], T]) -> T:
    """Open an archive, and return the result of a function that reads its content.

    Args:
        path: The file.
        read_content: Is called with a reader of the open archive. Errors that damaged content
            causes in it (`HoidError`, `DAMAGE`) are raised as `MapFileError`.

    Raises:
        MapFileError: The file does not exist, cannot be read, is damaged, or does not fit into
            memory.
    """
    try:
        if not path.is_file():  # also refuses pipes, whose opening would wait
            raise FileNotFoundError
        with zipfile.ZipFile(path) as archive:
            return read_content(Reader(archive, path.stat().st_size))
    except HoidError as error:
        raise MapFileError(f'{path}: {error}') from error
    except MemoryError as error:
        raise MapFileError(f'{path}: does not fit into memory') from error
    except FileNotFoundError as error:
        raise MapFileError(f'{path}: there is no such file') from error
    except OSError as error:
        raise MapFileError(f'{path}: cannot be read: {error.strerror}') from error
    except DAMAGE as error:
        text = ' '.join(str(error).split())[:_MAX_QUOTED]
        raise MapFileError(f'{path}: is no map file, or is damaged: {text}') from error


class Reader:
    """Reads an open archive.

    Beside MapFileError, the methods raise the errors in `DAMAGE` where the file is damaged.

    Args:
        archive: The archive.
        file_bytes: Size of its file.

    Raises:
        MapFileError: A member is neither stored uncompressed nor deflated.
    """

    def __init__(self, archive: zipfile.ZipFile, file_bytes: int) -> None:
        self._archive = archive
        self._infos = {info.filename: info for info in archive.infolist()}
        for name, info in self._infos.items():  # before anything is unpacked
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise MapFileError(f'"{name:.40}" is compressed by an unknown method')
        self._unpacked = sum(info.file_size for info in archive.infolist())
        self._limit = _SMALL_BYTES + _MAX_EXPANSION * file_bytes

    def manifest(self) -> dict[str, Any]:
        """Return the manifest.

        Raises:
            MapFileError: There is none, it is too large, or it is no dictionary.
        """
        info = self._infos.get(MANIFEST)
        if info is None or info.file_size > _MAX_MANIFEST_BYTES:
            raise MapFileError('is no map file: it has no manifest')
        content = json.loads(self._archive.read(info))
        if not isinstance(content, dict):
            raise MapFileError('is no map file: its manifest is of something else')
        return content

    def records(
        self, kinds: Mapping[str, type[Record]], lengths: Mapping[str, Mapping[str, int]]
    ) -> dict[str, Record]:
        """Return the records by section, after checking the sizes and headers of their arrays.

        Args:
            kinds: The type of record of each section that the archive may have.
            lengths: The lengths of the named axes of each section that the archive has.

        Raises:
            MapFileError: The archive would unpack to a size that no map has, its members are not
                exactly the arrays of these sections and the manifest, or an array has another
                size, type or shape than declared, or Boolean values other than 0 and 1.
        """
        if self._unpacked > self._limit:
            raise MapFileError(
                f'unpacks to {self._unpacked} bytes, more than any map of this size'
            )
        names = [_member(part, name) for part in lengths for name in kinds[part].columns()]
        found = sorted(info.filename for info in self._archive.infolist())
        if found != sorted([*names, MANIFEST]):
            raise MapFileError('is incomplete, or has foreign parts')
        return {
            part: record.of(
                {
                    name: self._array(_member(part, name), column, lengths[part])
                    for name, column in record.columns().items()
                }
            )
            for part, record in kinds.items()
            if part in lengths
        }

    def _array(self, name: str, column: Column, lengths: Mapping[str, int]) -> Array:
        """Return one array, read-only, after checking its size, header and Boolean values.

        Args:
            name: Name of the array's member in the archive.
            column: The declared type and shape.
            lengths: Lengths of the named axes.

        Raises:
            MapFileError: A check fails.
        """
        shape = column.shape(lengths)
        info = self._archive.getinfo(name)
        if info.file_size != _HEADER_BYTES + math.prod(shape) * column.dtype.itemsize:
            raise MapFileError(f'"{name}" has another size than its manifest requires')
        data = self._archive.read(info)
        if len(data) != info.file_size or data[:_HEADER_BYTES] != _header(column, lengths):
            raise MapFileError(f'"{name}" has another type or shape than its manifest requires')
        array: Array = np.frombuffer(data, column.dtype, offset=_HEADER_BYTES).reshape(shape)
        if column.dtype == np.bool_ and (array.view(np.uint8) > 1).any():
            raise MapFileError(f'"{name}" has Boolean values other than 0 and 1')
        return array


def _member(section: str, name: str) -> str:
    return f'{section}/{name}.npy'


def _header(column: Column, lengths: Mapping[str, int]) -> bytes:
    """Return the header of an array's member (NPY format 1.0); no other header is accepted."""
    shape = column.shape(lengths)
    text = f"{{'descr': {column.dtype.str!r}, 'fortran_order': False, 'shape': {shape}, }}"
    return struct.pack('<6sBBH', b'\x93NUMPY', 1, 0, _HEADER_BYTES - 10) + (
        text.ljust(_HEADER_BYTES - 11).encode() + b'\n'
    )
