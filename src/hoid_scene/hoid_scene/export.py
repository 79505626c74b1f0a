"""Writing and reading of points as PLY files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import InputError
from hoid_common.values import ByteArray
from hoid_scene.dense.submap import ColoredCloud

_POINT = np.dtype([('xyz', '<f4', 3)])
_COLORED = np.dtype([('xyz', '<f4', 3), ('rgb', 'u1', 3)])


def write_ply(
    path: Path, points_m: NDArray[np.floating], colors_bgr: ByteArray | None = None
) -> None:
    """Write points (N, 3), with colors (N, 3) if given, as a binary little-endian PLY file."""
    rows = np.empty(len(points_m), _POINT if colors_bgr is None else _COLORED)
    rows['xyz'] = points_m
    header = (
        f'ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n'
        'property float x\nproperty float y\nproperty float z\n'
    )
    if colors_bgr is not None:
        rows['rgb'] = colors_bgr[:, ::-1]
        header += 'property uchar red\nproperty uchar green\nproperty uchar blue\n'
    path.write_bytes(f'{header}end_header\n'.encode() + rows.tobytes())


def read_ply(path: Path) -> ColoredCloud:
    """Return the points of a PLY file that this suite wrote; points without color are white.

    InputError if the file cannot be read, or this suite did not write it.
    """
    try:
        header, end, body = path.read_bytes().partition(b'end_header\n')
    except OSError as error:
        raise InputError(f'{path}: cannot be read: {error.strerror}') from error
    count = re.search(rb'element vertex (\d+)\n', header)
    if not end or count is None or b'format binary_little_endian' not in header:
        raise InputError(f'{path}: not a PLY file of this suite')
    row = _COLORED if b'property uchar red' in header else _POINT
    if len(body) != int(count[1]) * row.itemsize:
        raise InputError(
            f'{path}: has {len(body)} bytes of points, '
            f'but its header announces {int(count[1])} points'
        )
    rows = np.frombuffer(body, row)
    white = np.full((len(rows), 3), 255, np.uint8)
    return ColoredCloud(rows['xyz'].copy(), rows['rgb'][:, ::-1] if row is _COLORED else white)
