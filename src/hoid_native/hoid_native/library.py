"""Find and load the compiled library."""

from __future__ import annotations

import ctypes
import sys
from ctypes import c_int32
from pathlib import Path
from typing import Any

_FILE = 'libhoid_native.so'


def _load() -> ctypes.CDLL:
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


_LIBRARY = _load()


def declare(name: str, *arguments: Any) -> Any:
    """Return a function of the library by its name and argument types; it returns an int32."""
    function = getattr(_LIBRARY, name)
    function.argtypes = arguments
    function.restype = c_int32
    return function
