"""Finds recordings of TUM RGB-D, Bonn RGB-D Dynamic, ETH3D and OpenLORIS by their folders."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from hoid_bags.tum.layouts import find_layout

WHERE = (
    'https://cvg.cit.tum.de/data/datasets/rgbd-dataset/download and '
    'https://www.ipb.uni-bonn.de/data/rgbd-dynamic-dataset'
)
"""Pages of the official sequences."""
_DEPTH = 2  # of folders below the given one: archives may unpack to a folder in a folder
_COPY = r'(?: ?\(\d+\))?'  # a browser's suffix of a second download
_TUM = re.compile(rf'(?:rgbd[ _-]dataset[ _-])?(?:freiburg|fr)([123])[ _-](.+?){_COPY}', re.I)
_BONN = re.compile(rf'(?:rgbd[ _-])?bonn[ _-](?!dataset$)(.+?){_COPY}', re.I)
# Starts of the short names by the layout of folders that have any names.
_BY_FILES = {'ETH3D': 'eth3d_', 'OpenLORIS': 'openloris_'}
_PACKED = re.compile(r'\.(?:tgz|tar|tar\.gz|zip)$', re.I)


def short_name(folder_name: str) -> str:
    """Return the short name of an official folder name; empty if the name is not official.

    `rgbd_dataset_freiburg3_walking_xyz` and `freiburg3-walking-xyz (1)` are `fr3_walking_xyz`,
    and `rgbd_bonn_crowd2` is `bonn_crowd2`.
    """
    if match := _TUM.fullmatch(folder_name):
        return f'fr{match[1]}_{_plain(match[2])}'
    match = _BONN.fullmatch(folder_name)
    return f'bonn_{_plain(match[1])}' if match else ''


def official_name(name: str) -> str:
    """Return the official folder name for a short name; empty if the name is not official."""
    if match := re.fullmatch(r'fr([123])_(\w+)', name):
        return f'rgbd_dataset_freiburg{match[1]}_{match[2]}'
    if match := re.fullmatch(r'bonn_(\w+)', name):
        return f'rgbd_bonn_{match[1]}'
    start = next(filter(name.startswith, _BY_FILES.values()), name)
    return name.removeprefix(start)


def find_official(folder: Path) -> dict[str, Path]:
    """Return the folders of official sequences by short name, in alphabetical order.

    The folder itself and folders up to two levels below it are considered. If several have the
    same short name, one with a list of images is preferred, then the outermost.
    """
    found: dict[str, list[Path]] = {}
    for path in _folders(folder.resolve(), _DEPTH):
        if name := short_name(path.name) or _name_by_files(path):
            found.setdefault(name, []).append(path)
    return {
        name: min(found[name], key=lambda p: (not _is_recording(p), len(p.parts), p.name))
        for name in sorted(found)
    }


def packed_official(folder: Path) -> list[str]:
    """Return the names of archives of official sequences in a folder that are not unpacked."""
    unpacked = find_official(folder)
    archives = sorted(p.name for p in folder.iterdir() if _PACKED.search(p.name))
    names = {archive: short_name(_PACKED.sub('', archive)) for archive in archives}
    return [archive for archive, name in names.items() if name and name not in unpacked]


def _folders(folder: Path, depth: int) -> Iterator[Path]:
    """Yield a folder and the folders below it, but none inside a recording."""
    yield folder
    if depth and not _is_recording(folder):
        for path in sorted(folder.iterdir()):
            if path.is_dir():
                yield from _folders(path, depth - 1)


def _name_by_files(path: Path) -> str:
    """Return the short name of a folder that is known by its files; empty for another one."""
    layout = find_layout(path)
    start = _BY_FILES.get(layout.name) if layout is not None else None
    return f'{start}{_plain(path.name)}' if start else ''


def _is_recording(folder: Path) -> bool:
    return find_layout(folder) is not None


def _plain(words: str) -> str:
    return re.sub(r'[ _-]+', '_', words.strip().lower())
