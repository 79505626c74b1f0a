"""Any text as a list of images, a trajectory or a camera file: read, or an InputError."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hoid_bags.tum.cameras import read_camera_yaml
from hoid_bags.tum.tum_folder import open_tum_folder
from hoid_common.errors import InputError
from hoid_common.io.tum_text import read_tum

pytestmark = pytest.mark.slow

FIELDS = st.sampled_from(
    ['1.5', '-1', '1e400', 'nan', '0x1', '#', 'rgb/1.png', '../1.png', '/dev/zero', '.', '', '\0']
)
LISTS = st.lists(st.lists(FIELDS | st.text(max_size=3), max_size=4).map(' '.join), max_size=5)
KEYS = st.sampled_from(
    ['image_width', 'image_height', 'camera_matrix', 'data', 'distortion_coefficients', 'x']
)
VALUES = st.recursive(
    st.sampled_from(['640', '-1', '1e400', 'null', '.nan', 'x', '2001-99-99', '!!int "x"', '*a']),
    lambda inner: (
        st.lists(inner, max_size=9).map(lambda items: f'[{", ".join(items)}]')
        | st.dictionaries(KEYS, inner, max_size=3).map(
            lambda pairs: f'{{{", ".join(f"{key}: {value}" for key, value in pairs.items())}}}'
        )
    ),
    max_leaves=9,
)


@settings(max_examples=60)
@given(LISTS, LISTS)
def test_a_list_of_images_is_read_or_refused(color: list[str], depth: list[str]) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        for kind, lines in (('rgb', color), ('depth', depth)):
            (folder / f'{kind}.txt').write_text('\n'.join(lines), encoding='utf-8')
        with suppress(InputError):
            open_tum_folder(folder)


NUMBERS = st.sampled_from(['0', '1', '-0.6', '0.8', '3.5', '1e400', '-1', 'nan', '', 'x', '#'])
POSES = st.lists(st.lists(NUMBERS, min_size=7, max_size=9).map(' '.join), max_size=5)


@settings(max_examples=60)
@given(POSES | st.text())
def test_a_trajectory_is_read_or_refused(lines: list[str] | str) -> None:
    with TemporaryDirectory() as name:
        path = Path(name) / 'trajectory.txt'
        path.write_text(lines if isinstance(lines, str) else '\n'.join(lines), encoding='utf-8')
        with suppress(InputError):
            read = read_tum(path)
            assert (np.diff(read.stamps_ns) > 0).all()
            turned = read.T_world_camera[:, :3, :3]
            same = np.broadcast_to(np.eye(3), turned.shape)
            np.testing.assert_allclose(turned @ turned.transpose(0, 2, 1), same, atol=1e-9)


@settings(max_examples=60)
@given(st.dictionaries(KEYS, VALUES, max_size=5))
def test_a_camera_file_is_read_or_refused(pairs: dict[str, str]) -> None:
    with TemporaryDirectory() as name:
        path = Path(name) / 'camera.yaml'
        path.write_text(''.join(f'{key}: {value}\n' for key, value in pairs.items()))
        with suppress(InputError):
            camera = read_camera_yaml(path)
            assert np.isfinite([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]).all()
