"""Folders of other data sets are known by their files; their truth and IMU are taken along."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.convert import convert
from hoid_bags.imu_recording import read_own_imu
from hoid_bags.sequence import open_sequence
from hoid_bags.tum.cameras import TUM_CAMERAS
from hoid_bags.tum.tum_folder import open_tum_folder
from hoid_common.errors import InputError
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel

NUM = 4
CAMERA = CameraModel(64, 48, 60.0, 61.0, 31.5, 23.5)
DEPTH_M = (1000 + 7 * np.arange(48 * 64) % 1500).reshape(48, 64) / 1000
PERIOD_S = 1 / 30
T_BASE_COLOR = T_BODY_OPTICAL.copy()
T_BASE_COLOR[:3, 3] = 0.2, 0.05, 1.0


def images(folder: Path, color: str, depth: str, units_per_m: float) -> None:
    """Write NUM images; `color` and `depth` are formats of a number."""
    for i in range(NUM):
        for name, pixels in (
            (color, np.full((48, 64, 3), 50 + i, np.uint8)),
            (depth, np.rint(DEPTH_M * units_per_m).astype(np.uint16)),
        ):
            path = folder / name.format(i)
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), pixels)


def lists(folder: Path, **names: str) -> None:
    """Write the lists of images by the names of the lists."""
    for name, pattern in names.items():
        lines = [f'{1 + i * PERIOD_S:.6f} {pattern.format(i)}' for i in range(NUM)]
        (folder / f'{name}.txt').write_text('\n'.join(lines) + '\n')


def truth(folder: Path) -> None:
    lines = [f'{1 + i * PERIOD_S:.6f} {i} 0 0 0 0 0 1' for i in range(NUM)]
    (folder / 'groundtruth.txt').write_text('\n'.join(lines) + '\n')


def eth3d(folder: Path) -> None:
    images(folder, 'rgb/{}.png', 'depth/{}.png', 5000)
    lists(folder, rgb='rgb/{}.png', depth='depth/{}.png')
    truth(folder)
    (folder / 'calibration.txt').write_text('60.0 61.0 31.5 23.5\n')


def bonn(folder: Path) -> None:
    images(folder, 'rgb/{}.png', 'depth/{}.png', 5000)
    lists(folder, rgb='rgb/{}.png', depth='depth/{}.png')
    truth(folder)


def openloris(folder: Path) -> None:
    """Write a recording whose poses are of the robot, 0.2 m behind its camera."""
    images(folder, 'color/{}.png', 'aligned_depth/{}.png', 1000)
    lists(folder, color='color/{}.png', aligned_depth='aligned_depth/{}.png')
    lines = [f'{1 + i * PERIOD_S:.6f} {i - 0.2} 0 0 0 0 0 1' for i in range(NUM)]
    (folder / 'groundtruth.txt').write_text('\n'.join(lines) + '\n')
    numbers = ', '.join(map(str, T_BASE_COLOR.ravel()))
    (folder / 'trans_matrix.yaml').write_text(
        '%YAML:1.0\ntrans_matrix:\n'
        '   -\n      parent_frame: base_link\n      child_frame: laser\n'
        '      matrix: !!opencv-matrix\n         rows: 1\n         cols: 1\n         dt: d\n'
        '         data: [ 1. ]\n'
        '   -\n      parent_frame: base_link\n      child_frame: d400_color_optical_frame\n'
        '      matrix: !!opencv-matrix\n         rows: 4\n         cols: 4\n         dt: d\n'
        f'         data: [ {numbers} ]\n'
    )
    (folder / 'sensors.yaml').write_text(
        '%YAML:1.0\nd400_color_optical_frame:\n   fps: 30\n   width: 64\n   height: 48\n'
        '   intrinsics: !!opencv-matrix\n      rows: 1\n      cols: 4\n      dt: d\n'
        '      data: [ 6.0e+01, 3.15e+01,\n          6.1e+01, 2.35e+01 ]\n'
        'd400_depth_optical_frame:\n   width: 64\n'
    )
    for name, z in (('d400_gyroscope', 0.1), ('d400_accelerometer', 9.8)):
        lines = ['# time x y z', *(f'{1 + 0.01 * i:.3f} 0 0 {z}' for i in range(10))]
        (folder / f'{name}.txt').write_text('\n'.join(lines) + '\n')


def replica(folder: Path) -> None:
    images(folder, 'results/frame{:06}.jpg', 'results/depth{:06}.png', 6553.5)
    rows = []
    for i in range(NUM):
        T = np.eye(4)
        T[0, 3] = i
        rows.append(' '.join(map(str, T.ravel())))
    (folder / 'traj.txt').write_text('\n'.join(rows) + '\n')
    camera = {'w': 64, 'h': 48, 'fx': 60.0, 'fy': 61.0, 'cx': 31.5, 'cy': 23.5, 'scale': 6553.5}
    (folder.parent / 'cam_params.json').write_text(json.dumps({'camera': camera}))


def open3d(folder: Path) -> None:
    images(folder, 'color/{:05}.jpg', 'depth/{:05}.png', 1000)
    matrix = [60.0, 0, 0, 0, 61.0, 0, 31.5, 23.5, 1]
    camera = {'width': 64, 'height': 48, 'intrinsic_matrix': matrix}
    (folder / 'intrinsic.json').write_text(json.dumps(camera))


def test_a_tum_folder_may_state_its_camera(tmp_path: Path) -> None:
    folder = tmp_path / 'freiburg1_copy'
    folder.mkdir()
    bonn(folder)
    (folder / 'camera.yaml').write_text(
        'image_width: 64\nimage_height: 48\n'
        'camera_matrix: {data: [60.0, 0, 31.5, 0, 61.0, 23.5, 0, 0, 1]}\n'
    )
    assert open_sequence(folder).camera == CAMERA
    assert open_sequence(folder, TUM_CAMERAS['fr1']).camera == TUM_CAMERAS['fr1']
    (folder / 'camera.yaml').write_text('image_width: 64\n')
    with pytest.raises(InputError, match=r'camera\.yaml: '):
        open_sequence(folder)


WRITERS = {
    'ETH3D': (eth3d, True), 'TUM': (bonn, True), 'OpenLORIS': (openloris, True),
    'Replica': (replica, True), 'Open3D': (open3d, False),
}  # fmt: skip


@pytest.mark.parametrize('name', WRITERS)
def test_a_layout_is_known_by_its_files(name: str, tmp_path: Path) -> None:
    writer, has_truth = WRITERS[name]
    folder = tmp_path / 'recording'
    folder.mkdir()
    writer(folder)
    given = CAMERA if name == 'TUM' else None
    sequence = open_sequence(folder, given)
    expected = '' if name == 'TUM' else f'{name} layout: color '
    assert str(sequence)[: len(expected) or None] == expected
    assert sequence.camera == CAMERA
    frames = list(sequence)
    assert len(frames) == NUM
    for i, frame in enumerate(frames):
        assert frame.stamp_ns == pytest.approx(1e9 + i * PERIOD_S * 1e9, abs=2000)
        assert abs(int(frame.image_bgr[0, 0, 0]) - 50 - i) <= 1
        np.testing.assert_allclose(frame.depth_m, DEPTH_M, atol=1e-3)
    found = sequence.ground_truth
    assert (found is not None) == has_truth
    if found is not None:
        assert found.T_world_camera[:, 0, 3].tolist() == [0, 1, 2, 3]
    convert(folder, tmp_path / 'bag', None, given)
    for frame, again in zip(frames, open_sequence(tmp_path / 'bag'), strict=True):
        np.testing.assert_allclose(frame.depth_m, again.depth_m, atol=1e-6)
    with BagReader(tmp_path / 'bag') as reader:
        names = {topic.name for topic in reader.topics if topic.num_messages}
    assert ('/ground_truth' in names) == has_truth
    assert ('/imu' in names) == ('/imu/accelerometer' in names) == (name == 'OpenLORIS')


def test_the_truth_of_openloris_is_moved_to_the_camera(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    openloris(tmp_path)
    truth = open_sequence(tmp_path).ground_truth
    assert truth is not None
    for i, T in enumerate(truth.T_world_camera):
        np.testing.assert_allclose(T[:3, :3], T_BODY_OPTICAL[:3, :3], atol=1e-9)
        np.testing.assert_allclose(T[:3, 3], [i, 0.05, 1.0], atol=1e-9)
    for text, problem in (
        (
            '%YAML:1.0\ntrans_matrix:\n   - { parent_frame: a }\n',
            'has no d400_color_optical_frame',
        ),
        ('{', 'is no YAML file of OpenCV'),
        ('%YAML:1.0\ntrans_matrix: 5\n', 'has no d400_color_optical_frame'),
        ('%YAML:1.0\ntrans_matrix: [1, 2]\n', 'has no d400_color_optical_frame'),
        (
            '%YAML:1.0\ntrans_matrix:\n   - { matrix: [1, 0, 0] }\n',
            'has no d400_color_optical_frame',
        ),
    ):
        (tmp_path / 'trans_matrix.yaml').write_text(text)
        assert open_sequence(tmp_path).ground_truth is None
        assert f'trans_matrix.yaml: {problem}' in caplog.text


def test_the_imu_of_openloris_is_found(tmp_path: Path) -> None:
    openloris(tmp_path)
    imu = read_own_imu(tmp_path)
    assert imu.rates is not None
    assert imu.accelerations is not None
    assert (imu.rates.values[:, 2] == 0.1).all()
    assert (imu.accelerations.values[:, 2] == 9.8).all()


@pytest.mark.parametrize(
    ('name', 'text', 'expected'),
    [
        ('calibration.txt', '60 61', r'calibration\.txt: expected fx fy cx cy'),
        ('calibration.txt', 'a b c d', r'calibration\.txt: expected fx fy cx cy'),
        ('intrinsic.json', '{', r'intrinsic\.json: is not JSON'),
        ('intrinsic.json', '[]', r'intrinsic\.json: expected a JSON object'),
        ('intrinsic.json', '{"intrinsic_matrix": [1]}', 'intrinsic_matrix must have nine numbers'),
        ('sensors.yaml', 'd400_color_optical_frame:', r'sensors\.yaml: has no intrinsics'),
        ('traj.txt', '1 2 3', 'None'),
    ],
)
def test_files_that_state_no_camera_are_named(
    name: str, text: str, expected: str, tmp_path: Path
) -> None:
    writer = {
        'calibration.txt': eth3d, 'intrinsic.json': open3d, 'traj.txt': replica,
        'sensors.yaml': openloris,
    }[name]  # fmt: skip
    folder = tmp_path / 'recording'
    folder.mkdir()
    writer(folder)
    (folder / name).write_text(text)
    if name == 'traj.txt':  # a bad truth is a warning
        assert open_sequence(folder).ground_truth is None
        return
    with pytest.raises(InputError, match=expected):
        open_sequence(folder)


def test_given_units_come_before_those_of_the_layout(tmp_path: Path) -> None:
    open3d(tmp_path)
    frame = next(iter(open_tum_folder(tmp_path, None, 500.0)))
    np.testing.assert_allclose(frame.depth_m, 2 * DEPTH_M, atol=1e-3)
