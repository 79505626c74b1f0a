"""Writing and reading of colored clouds as PLY files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from hoid_common.errors import InputError
from hoid_scene.dense.submap import ColoredCloud

_PLY = np.dtype([('xyz', '<f4', 3), ('rgb', 'u1', 3)])


def write_ply(path: Path, cloud: ColoredCloud) -> None:
    """Write a cloud as a binary little-endian PLY file with x y z [m] and red green blue."""
    rows = np.empty(len(cloud.points_m), _PLY)
    rows['xyz'], rows['rgb'] = cloud.points_m, cloud.colors_bgr[:, ::-1]
    header = (
        f'ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n'
        'property float x\nproperty float y\nproperty float z\n'
        'property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n'
    )
    path.write_bytes(header.encode() + rows.tobytes())


def read_ply(path: Path) -> ColoredCloud:
    """Return the points of a PLY file that this suite wrote; points without color are white.

    Raises:
        InputError: The file cannot be read, is of another kind, or is shorter or longer than its
            header says.
    """
    try:
        header, end, body = path.read_bytes().partition(b'end_header\n')
    except OSError as error:
        raise InputError(f'{path}: cannot be read: {error.strerror}') from error
    count = re.search(rb'element vertex (\d+)\n', header)
    if not end or count is None or b'format binary_little_endian' not in header:
        raise InputError(f'{path}: not a PLY file of this suite')
    row = _PLY if b'property uchar red' in header else np.dtype([('xyz', '<f4', 3)])
    if len(body) != int(count[1]) * row.itemsize:
        raise InputError(
            f'{path}: has {len(body)} bytes of points, '
            f'but its header announces {int(count[1])} points'
        )
    rows = np.frombuffer(body, row)
    white = np.full((len(rows), 3), 255, np.uint8)
    return ColoredCloud(rows['xyz'].copy(), rows['rgb'][:, ::-1] if row is _PLY else white)
