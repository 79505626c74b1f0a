"""Unpacking of bag files that were compressed as a whole, up to a limit.

rosbags unpacks such files without a limit, so that a small file could fill the disk.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from backports import zstd

from hoid_common.errors import InputError
from hoid_common.io.untrusted import open_regular

SUFFIX: Final = '.zstd'
# Chosen: a file is refused if it unpacks to more than _SMALL_BYTES plus this multiple of its size.
# Raw images of a static scene reach a ratio of 10.
_MAX_RATIO = 100
_SMALL_BYTES = 1 << 26  # chosen: files up to this size are unpacked at any ratio
_BLOCK_BYTES = 1 << 20  # chosen: memory for one block


def unpack_file(path: Path, folder: Path) -> Path:
    """Unpack a zstd file into a folder; return the path of the result, without the suffix .zstd.

    A truncated or damaged file is unpacked up to the damage. InputError: the result is empty, over
    64 MiB plus 100 times the file's size, or more than fits on the disk.
    """
    target = folder / path.stem
    limit = _SMALL_BYTES + _MAX_RATIO * path.stat().st_size
    size = 0
    try:
        with (
            open_regular(path) as packed,
            zstd.open(packed, 'rb') as source,
            target.open('wb') as file,
        ):
            while block := source.read(_BLOCK_BYTES):
                size += len(block)
                if size > limit:
                    raise InputError(f'{path}: unpacks to over {limit} bytes, which no bag does')
                file.write(block)
    except (zstd.ZstdError, EOFError, OSError) as error:
        if size and not isinstance(error, OSError):
            return target
        raise InputError(f'{path}: cannot be unpacked into {folder}: {error}') from error
    return target
