"""Find and load the compiled library."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

_FILE = 'libhoid_native.so'


def load() -> ctypes.CDLL:
    """Load the library from this package, or from the workspace that this source tree built.

    Raises:
        ImportError: The library has not been built.

    """
    here = Path(__file__).parent
    installed = (Path(entry) / 'hoid_native' for entry in sys.path)
    workspace = here.parents[2] / 'install' / 'hoid_native'
    built = sorted(workspace.glob('l*/python3*/*-packages/hoid_native'))
    for folder in (here, *installed, *built):
        if (folder / _FILE).is_file():
            return ctypes.CDLL(str(folder / _FILE))
    raise ImportError(f'{_FILE} is not built: run "make build", or colcon build and source it')
