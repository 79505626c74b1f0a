"""Reading of clouds that were written to files, and refusal of other files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hoid_common.errors import InputError
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.export import read_ply, write_ply

HEADER = b'ply\nformat binary_little_endian 1.0\nelement vertex 2\n'


@pytest.mark.parametrize('count', [0, 1, 1000])
def test_a_ply_reads_back(tmp_path: Path, count: int) -> None:
    rng = np.random.default_rng(count)
    points_m = rng.normal(size=(count, 3)).astype(np.float32)
    cloud = ColoredCloud(points_m, rng.integers(0, 256, (count, 3), np.uint8))
    write_ply(tmp_path / 'a.ply', *cloud)
    for read, written in zip(read_ply(tmp_path / 'a.ply'), cloud, strict=True):
        np.testing.assert_array_equal(read, written)


@pytest.mark.parametrize(
    ('data', 'message'),
    [
        (HEADER.replace(b'binary_little_endian', b'ascii') + b'end_header\n1 2 3\n', 'not a PLY'),
        (HEADER + b'end_header\n1234', '4 bytes of points, but its header announces 2 points'),
        (HEADER, 'not a PLY file of this suite'),
        (b'', 'not a PLY file of this suite'),
    ],
)
def test_other_files_are_no_clouds(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / 'a.ply').write_bytes(data)
    with pytest.raises(InputError, match=message):
        read_ply(tmp_path / 'a.ply')
    with pytest.raises(InputError, match='cannot be read'):
        read_ply(tmp_path / 'b.ply')
