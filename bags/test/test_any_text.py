"""Any text, as a list of images or a camera file: read, or refused by an InputError."""

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


@settings(max_examples=60)
@given(st.dictionaries(KEYS, VALUES, max_size=5))
def test_a_camera_file_is_read_or_refused(pairs: dict[str, str]) -> None:
    with TemporaryDirectory() as name:
        path = Path(name) / 'camera.yaml'
        path.write_text(''.join(f'{key}: {value}\n' for key, value in pairs.items()))
        with suppress(InputError):
            camera = read_camera_yaml(path)
            assert np.isfinite([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]).all()
