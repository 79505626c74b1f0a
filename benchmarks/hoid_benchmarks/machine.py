"""What machine and versions a result comes from."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

_LIBRARIES = ('numpy', 'opencv-python-headless', 'onnxruntime', 'gtsam', 'evo')


def machine() -> str:
    """Return processor, cores and memory in one line."""
    memory_gib = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30
    return f'{_processor()}, {os.cpu_count()} cores, {memory_gib:.0f} GiB, {platform.system()}'


def versions() -> str:
    """Return the versions of Python and of the libraries that results depend on."""
    found = [f'{name} {_version(name)}' for name in _LIBRARIES]
    return ', '.join([f'Python {platform.python_version()}', *found])


def _processor() -> str:
    info = Path('/proc/cpuinfo')
    names = (
        line.split(':', 1)[1].strip()
        for line in (info.read_text().splitlines() if info.is_file() else ())
        if line.startswith('model name')
    )
    return next(names, platform.machine())


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return 'not installed'
