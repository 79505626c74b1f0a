from __future__ import annotations

from pathlib import Path

import pytest

from hoid_bags.tum.cameras import camera_from_name, find_camera, read_camera_yaml
from hoid_common.errors import InputError

YAML = """\
image_width: 640
image_height: 480
camera_name: head
camera_matrix: {rows: 3, cols: 3, data: [500.5, 0, 320.1, 0, 501.5, 240.2, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0.001, 0.002, 0]}
"""


@pytest.mark.parametrize(
    ('name', 'fx_px'),
    [
        ('rgbd_dataset_freiburg1_xyz', 517.306408),
        ('fr1_xyz', 517.306408),
        ('FR2-desk', 520.908620),
        ('freiburg 3', 535.4),
        ('my_fr3_walking', 535.4),
        ('rgbd_bonn_crowd2', 542.822841),
    ],
)
def test_a_folder_name_says_which_camera(name: str, fx_px: float) -> None:
    known = camera_from_name(name)
    assert known is not None
    assert known.fx_px == fx_px


@pytest.mark.parametrize('name', ['kitchen', 'afr1_x', 'fr4_desk', 'fr12', 'freiburg', 'bonny'])
def test_other_names_say_nothing(name: str) -> None:
    assert camera_from_name(name) is None


def test_camera_info_yaml(tmp_path: Path) -> None:
    path = tmp_path / 'camera.yaml'
    path.write_text(YAML)
    camera = find_camera(str(path))
    assert (camera.width_px, camera.height_px) == (640, 480)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (500.5, 501.5, 320.1, 240.2)
    assert camera.distortion == (0.1, -0.2, 0.001, 0.002, 0.0)


@pytest.mark.parametrize(
    ('old', 'new', 'expected'),
    [
        ('500.5', '0', 'focal lengths must be in [32, 64000] px at 640x480, got fx=0.0'),
        ('501.5', '-1', 'focal lengths must be in'),
        ('501.5', '.nan', 'focal lengths must be in'),
        ('camera_matrix', 'matrix', 'camera_matrix.data is missing'),
        ('[500.5, 0, 320.1, ', '[', 'camera_matrix.data has 6 numbers, expected 9'),
        ('[500.5', '["x"', 'camera_matrix.data is missing or not a list of numbers'),
        ('image_width: 640', 'image_width: wide', 'image_width must be a positive whole number'),
        ('image_height: 480', '', 'image_height must be a positive whole number, got None'),
        ('plumb_bob', 'mei', 'distortion_model "mei"'),
        ('image_width:', 'image_width: [', 'is not YAML'),
    ],
)
def test_bad_camera_files(tmp_path: Path, old: str, new: str, expected: str) -> None:
    path = tmp_path / 'camera.yaml'
    path.write_text(YAML.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_camera_yaml(path)
    message = str(caught.value)
    assert expected in message
    assert str(path) in message
    assert '\n' not in message


def test_missing_camera() -> None:
    with pytest.raises(InputError, match='camera "fr9": neither fr1, fr2, fr3, bonn nor a file'):
        find_camera('fr9')
