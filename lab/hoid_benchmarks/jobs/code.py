"""The version of the code that produces a result."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from hoid_bringup.run.provenance import commit

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
        return cls(digest.hexdigest()[:12], commit(root))


def _sources(root: Path) -> list[Path]:
    found = (p for f in _CODE_FOLDERS for kind in _SOURCES for p in (root / f).rglob(kind))
    return sorted(p for p in found if not {'test', 'training'} & set(p.relative_to(root).parts))
