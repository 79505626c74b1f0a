"""Lists of the objects that stand in real recordings, with their boxes in some images."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common.errors import InputError
from hoid_common.io.yaml_file import read_yaml
from hoid_common.values import Float32Array, FloatArray

_LISTS = Path(__file__).with_name('lists')


class ListedObject(NamedTuple):
    """An object of a recording."""

    name: str
    classes: tuple[str, ...]  # COCO classes that are right for it
    boxes_px: dict[int, Float32Array]  # by stamp [ns]: (4,) x1, y1, x2, y2
    is_unsure: bool  # True: it may be in an object map, but need not


def listed_recordings() -> list[str]:
    """Return the names of the recordings that have a list."""
    return sorted(path.stem for path in _LISTS.glob('*.yaml'))


def reference_up(name: str) -> FloatArray | None:
    """Return the direction up (3,) in the frame of the reference poses, or None."""
    up = read_yaml(_LISTS / f'{name}.yaml').get('up')
    return None if up is None else np.array(up, float)


def read_list(name: str) -> list[ListedObject]:
    """Return the objects of a recording.

    Raises:
        InputError: The recording has no list.
    """
    if name not in listed_recordings():
        raise InputError(f'{name} has no list of objects: {", ".join(listed_recordings())}')
    content = read_yaml(_LISTS / f'{name}.yaml')
    stamps_ns = {key: round(second * 1e6) * 1000 for key, second in content['images'].items()}
    return [
        ListedObject(
            object_name,
            tuple(entry['classes']),
            {
                ns: np.array(entry[key], np.float32)
                for key, ns in stamps_ns.items()
                if key in entry
            },
            part == 'unsure',
        )
        for part in ('objects', 'unsure')
        for object_name, entry in content[part].items()
    ]
