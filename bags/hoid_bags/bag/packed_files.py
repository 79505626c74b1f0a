"""Bags whose files are packed as a whole, which the bag library unpacks without limit."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Final

from backports import zstd

from hoid_common.errors import InputError

SUFFIX: Final = '.zstd'
MOST_UNPACKED: Final = 100
"""Times the size of the file; raw images of a still room unpack to a tenth of that."""
_SMALL_BYTES = 1 << 26  # that many are harmless whatever they are packed to
_BLOCK_BYTES = 1 << 20


def check_packed(folder: Path) -> None:
    """Unpack every packed file of a bag to nowhere, as far as the limit.

    Raises:
        InputError: One unpacks to more than any bag does, or than fits where it is unpacked.
        ZstdError: One is damaged.
        OSError: One cannot be read.
    """
    place = Path(tempfile.gettempdir())
    left = shutil.disk_usage(place).free
    for path in sorted(folder.glob(f'*{SUFFIX}')):
        limit = _SMALL_BYTES + MOST_UNPACKED * path.stat().st_size
        size = 0
        with zstd.open(path, 'rb') as file:
            while block := file.read(_BLOCK_BYTES):
                size += len(block)
                if size > limit:
                    raise InputError(f'{path}: unpacks to over {limit} bytes, which no bag does')
                if size > left:
                    raise InputError(f'{path}: does not fit into {place} when it is unpacked')
        left -= size
