"""The machine and the version of the code that produce a result."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from dataclasses import dataclass
from pathlib import Path

_SOURCES = ('*.py', '*.cpp', '*.hpp', '*.h', '*.onnx')
_CODE_FOLDERS = ('src', 'bags')  # folders of the code that a run executes


@dataclass(frozen=True)
class Code:
    """Version of the project."""

    digest: str  # of sources and models, without tests and training
    commit: str  # marked if files differ from it; empty outside a clone

    @classmethod
    def of(cls, root: Path) -> Code:
        """Return the version of a checkout."""
        digest = hashlib.sha256()
        for path in _sources(root):
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
        return cls(digest.hexdigest()[:12], _commit(root))


def machine() -> str:
    """Return processor, cores and memory in one line."""
    memory_gib = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30
    return f'{_processor()}, {os.cpu_count()} cores, {memory_gib:.0f} GiB, {platform.system()}'


def _sources(root: Path) -> list[Path]:
    found = (p for f in _CODE_FOLDERS for kind in _SOURCES for p in (root / f).rglob(kind))
    return sorted(p for p in found if not {'test', 'training'} & set(p.relative_to(root).parts))


def _commit(root: Path) -> str:
    command = ['git', '-C', str(root), 'describe', '--always', '--dirty', '--exclude=*']
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ''
    return done.stdout.strip()


def _processor() -> str:
    info = Path('/proc/cpuinfo')
    names = (
        line.split(':', 1)[1].strip()
        for line in (info.read_text().splitlines() if info.is_file() else ())
        if line.startswith('model name')
    )
    return next(names, platform.machine())
