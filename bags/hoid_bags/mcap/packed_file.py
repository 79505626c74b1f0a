"""Files of bags that were compressed as a whole, unpacked within a limit.

rosbags unpacks them without one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from backports import zstd

from hoid_common.errors import InputError
from hoid_common.io.untrusted import open_regular

SUFFIX: Final = '.zstd'
_MAX_RATIO = 100  # unpacked to packed. Chosen: raw images of a static scene reach a tenth of it
_SMALL_BYTES = 1 << 26  # chosen: small enough to be unpacked at any ratio
_BLOCK_BYTES = 1 << 20  # chosen: memory for one block


def unpack_file(path: Path, folder: Path) -> Path:
    """Unpack a file into a folder, and return the path of the result.

    Raises:
        InputError: The file is damaged, unpacks to more than any bag does, or does not fit.
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
        raise InputError(f'{path}: cannot be unpacked into {folder}: {error}') from error
    return target
