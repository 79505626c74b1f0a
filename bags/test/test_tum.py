from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_bags.sequence import open_sequence
from hoid_bags.tum.tum_folder import open_tum_folder
from hoid_common import se3
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.tum_text import read_tum, write_tum, write_tum_parts
from hoid_common.values import CameraModel, Trajectory

FolderMaker = Callable[..., Path]
SHARED = Path(__file__).resolve().parents[3] / 'shared' / 'data'


def image(folder: Path, kind: str, index: int = 1) -> Path:
    return sorted((folder / kind).iterdir())[index]


def fault_of(folder: Path, camera: CameraModel) -> str:
    """Return the error message of opening and reading a folder."""
    with pytest.raises(InputError) as caught:
        list(open_sequence(folder, camera))
    assert '\n' not in str(caught.value)
    return str(caught.value)


def test_frames_are_the_files(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(3)
    sequence = open_sequence(folder, camera, 5000.0)
    frames = list(sequence)
    assert len(sequence) == len(frames) == 3
    assert frames[0].stamp_ns == 1_305_031_102_175_304_123
    assert sequence.ground_truth is None
    assert sequence.fault is None
    for i, frame in enumerate(frames):
        color = cv2.imread(str(image(folder, 'rgb', i)))
        depth = cv2.imread(str(image(folder, 'depth', i)), cv2.IMREAD_UNCHANGED)
        assert color is not None
        assert depth is not None
        np.testing.assert_array_equal(frame.image_bgr, color)
        assert frame.depth_m.dtype == np.float32
        expected_m = np.where(depth >= 250, depth / 5000.0, 0).astype(np.float32)  # 0.05 m
        np.testing.assert_array_equal(frame.depth_m, expected_m)
    assert [frame.stamp_ns for frame in sequence] == [frame.stamp_ns for frame in frames]


def test_comments_tabs_and_commas_in_lists(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(2)
    text = (folder / 'rgb.txt').read_text().replace(' rgb/', '\trgb/')
    (folder / 'rgb.txt').write_text('\ufeff' + text.replace('\n', '\r\n') + '\n  # end\n\n')
    (folder / 'depth.txt').write_text((folder / 'depth.txt').read_text().replace(' dep', ',dep'))
    assert len(open_sequence(folder, camera)) == 2


def test_truth_and_accelerometer(
    make_folder: FolderMaker, with_truth: Callable[[Path], Path], camera: CameraModel
) -> None:
    folder = open_tum_folder(with_truth(make_folder(1)), camera)
    truth, accelerometer = folder.ground_truth, folder.layout.imu(folder.path)[1]
    assert truth is not None
    assert truth.stamps_ns.tolist() == [1_305_031_102_175_300_000, 1_305_031_102_200_000_000]
    expected = np.array([[0, -1, 0, 1.5], [1, 0, 0, -0.25], [0, 0, 1, 2.0], [0, 0, 0, 1]])
    np.testing.assert_allclose(truth.T_world_camera[0], expected, atol=1e-12)
    assert accelerometer is not None
    assert accelerometer.stamps_ns.tolist() == [1_305_031_102_176_000_001]
    assert accelerometer.values.tolist() == [[-0.478957, 8.01056, -4.166928]]


def test_missing_folder(tmp_path: Path, camera: CameraModel) -> None:
    assert 'nowhere: no such file or folder' in fault_of(tmp_path / 'nowhere', camera)


def test_folder_without_lists(tmp_path: Path, camera: CameraModel) -> None:
    assert 'neither a TUM folder (no rgb.txt) nor a bag' in fault_of(tmp_path, camera)


def test_a_file_that_is_no_recording(tmp_path: Path, camera: CameraModel) -> None:
    path = tmp_path / 'notes.txt'
    path.write_text('hello')
    assert 'neither a TUM folder (no rgb.txt) nor a bag' in fault_of(path, camera)


def test_empty_list(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(2)
    (folder / 'rgb.txt').write_text('# only a comment\n')
    assert 'rgb.txt: lists no images' in fault_of(folder, camera)


def test_list_of_bytes(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(2)
    (folder / 'depth.txt').write_bytes(b'\xff\xfe\x00\x80')
    assert 'depth.txt: not a text file' in fault_of(folder, camera)


def test_list_names_a_missing_file(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(3)
    gone = image(folder, 'depth', 2)
    gone.unlink()
    assert f'depth.txt: line 5: lists "depth/{gone.name}"' in fault_of(folder, camera)


def test_stamp_that_is_no_number(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(2)
    (folder / 'rgb.txt').write_text('soon rgb/a.png\n')
    assert 'rgb.txt: line 1: "soon" is not a time' in fault_of(folder, camera)


@pytest.mark.parametrize('kind', ['rgb', 'depth'])
def test_stamps_that_go_backwards(
    make_folder: FolderMaker, camera: CameraModel, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = make_folder(3)
    lines = (folder / f'{kind}.txt').read_text().splitlines()
    lines[3], lines[4] = lines[4], lines[3]
    (folder / f'{kind}.txt').write_text('\n'.join(lines))
    assert len(list(open_sequence(folder, camera))) == 3
    assert f'{kind}.txt: late stamps sorted in: 1' in caplog.text


@pytest.mark.parametrize(('kind', 'ext'), [('rgb', 'png'), ('rgb', 'jpg'), ('depth', 'png')])
@pytest.mark.parametrize('kept', [0.0, 0.5, 0.97])
def test_truncated_image(
    make_folder: FolderMaker, camera: CameraModel, kind: str, ext: str, kept: float
) -> None:
    folder = make_folder(3, ext=ext)
    path = image(folder, kind)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * kept)])
    assert f'{path}: truncated image' in fault_of(folder, camera)


def test_image_of_other_bytes(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(2)
    path = image(folder, 'rgb')
    path.write_text('<html>not found</html>')
    assert f'{path}: image of 22 bytes is not a readable JPEG, PNG or TIFF' in fault_of(
        folder, camera
    )


@pytest.mark.parametrize('kind', ['rgb', 'depth'])
def test_image_said_to_be_huge(make_folder: FolderMaker, camera: CameraModel, kind: str) -> None:
    folder = make_folder()
    path = image(folder, kind)
    png = path.read_bytes()
    header = png[12:16] + (60_000).to_bytes(4, 'big') * 2 + png[24:29]
    path.write_bytes(png[:12] + header + zlib.crc32(header).to_bytes(4, 'big') + png[33:])
    assert 'claims to be 60000x60000 px' in fault_of(folder, camera)


@pytest.mark.parametrize(
    ('pixels', 'expected'),
    [
        (np.zeros((24, 32), np.uint8), 'got 8-bit with 1 channel'),
        (np.zeros((24, 32, 3), np.uint8), 'got 8-bit with 3 channel'),
        (np.zeros((24, 32, 3), np.uint16), 'got 16-bit with 3 channel'),
    ],
)
def test_depth_of_another_kind(
    make_folder: FolderMaker, camera: CameraModel, pixels: np.ndarray, expected: str
) -> None:
    folder = make_folder(2)
    path = image(folder, 'depth')
    cv2.imwrite(str(path), pixels)
    assert f'{path}: depth must be 16-bit gray, {expected}' in fault_of(folder, camera)


def test_camera_of_another_size(make_folder: FolderMaker) -> None:
    folder = make_folder(2, name='fr1_small')
    with pytest.raises(InputError, match='image is 32x24, the camera 640x480'):
        list(open_sequence(folder))


def test_name_that_says_no_camera(make_folder: FolderMaker) -> None:
    with pytest.raises(InputError, match='give --calibration'):
        open_sequence(make_folder(1, name='kitchen'))


def test_lists_that_never_meet(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(1)
    (folder / 'depth.txt').write_text(f'12.5 depth/{image(folder, "depth", 0).name}\n')
    assert 'stamps of depth are -1305031089.675 s from those of color, so two clocks' in fault_of(
        folder, camera
    )


def test_a_wrong_depth_factor_is_noticed(make_folder: FolderMaker) -> None:
    folder = make_folder(1, scale=5)
    camera = CameraModel(160, 120, 150.0, 155.0, 77.5, 57.5)
    with pytest.raises(InputError, match=r'median of \d+ m, .* it is 1/1 m; set --depth-factor'):
        list(open_sequence(folder, camera, 1.0))


@pytest.mark.parametrize('factor', [0.0, -5000.0, float('nan'), float('inf')])
def test_depth_factor(make_folder: FolderMaker, camera: CameraModel, factor: float) -> None:
    with pytest.raises(ConfigError, match='depth units per meter must be positive'):
        open_sequence(make_folder(1), camera, factor)


def test_trajectory_round_trip(tmp_path: Path) -> None:
    twists = np.random.default_rng(1).normal(size=(20, 6))
    stamps_ns = 1_305_031_102_175_304_001 + np.arange(20) * 7
    before = Trajectory(stamps_ns, se3.exp(twists))
    write_tum(tmp_path / 't.txt', before)
    after = read_tum(tmp_path / 't.txt')
    np.testing.assert_array_equal(after.stamps_ns, before.stamps_ns)
    np.testing.assert_allclose(after.T_world_camera, before.T_world_camera, atol=2e-9)


def test_empty_trajectory_round_trip(tmp_path: Path) -> None:
    write_tum(tmp_path / 't.txt', Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4))))
    assert len(read_tum(tmp_path / 't.txt')) == 0


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('1 0 0 0 0 0 0\n', 'line 1: not 7 numbers'),
        ('1 0 0 0 0 0 0 one\n', 'line 1: not 7 numbers'),
        ('1 0 0 nan 0 0 0 1\n', 'not finite'),
        ('1 0 0 0 0 0 0 0\n', "the quaternion's norm is 0"),
    ],
)
def test_bad_trajectories(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / 'truth.txt'
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_tum(path)
    assert expected in str(caught.value)
    assert '\n' not in str(caught.value)


def test_a_trajectory_in_which_time_starts_anew_keeps_the_last_pass(tmp_path: Path) -> None:
    stamps_s = [1, 2, 3, 3, 1, 2, 2, 4]
    poses = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    poses[:, 0, 3] = np.arange(len(stamps_s))
    stamps_ns = np.array(stamps_s) * 10**9
    parts = [Trajectory(stamps_ns[:5], poses[:5]), Trajectory(stamps_ns[5:], poses[5:])]
    written = write_tum_parts(tmp_path / 't.txt', parts)
    after = read_tum(tmp_path / 't.txt')
    assert (after.stamps_ns / 1e9).tolist() == [1, 2, 4]
    assert after.T_world_camera[:, 0, 3].tolist() == [4, 5, 7]
    assert str(written) == (
        '3 poses since time started anew (3 earlier ones left out) '
        '(2 with a repeated or older stamp left out)'
    )


def test_bad_rows_of_a_trajectory_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    good = [f'{t} {t} 0 0 0 0 0 1' for t in (1, 2, 4, 3, 3, 5)]
    bad = ['2.5 nan nan nan nan nan nan nan', '2.7 0 0 0 0 0 0 0', 'stamp x y z', '9 1 2']
    path = tmp_path / 'truth.txt'
    path.write_text('\n'.join([*good[:2], *bad, *good[2:]]))
    truth = read_tum(path)
    assert (truth.stamps_ns / 1e9).tolist() == [1, 2, 3, 4, 5]
    assert truth.T_world_camera[:, 0, 3].tolist() == [1, 2, 3, 4, 5]
    assert f'{path}: 4 unusable rows left out (line 3: ' in caplog.text
    assert 'repeated stamps left out: 1, late stamps sorted in: 2' in caplog.text


def test_a_constant_offset_between_color_and_depth_is_named_and_can_be_allowed(
    make_folder: FolderMaker, camera: CameraModel
) -> None:
    folder = make_folder(7)
    rgb = (folder / 'rgb.txt').read_text().splitlines()[2::2]  # 15 Hz
    depth = (folder / 'depth.txt').read_text().splitlines()[2::2]
    shifted = [
        f'{float(color.split()[0]) + 0.025:.6f} {name.split()[1]}'
        for color, name in zip(rgb, depth, strict=True)
    ]
    (folder / 'rgb.txt').write_text('\n'.join(rgb))
    (folder / 'depth.txt').write_text('\n'.join(shifted))
    assert (
        'depth are +25.0 ms from those of color (limit 20): raise sync_slop_s to 0.030'
        in fault_of(folder, camera)
    )
    assert len(open_sequence(folder, camera, max_gap_ns=30_000_000)) == 4


@pytest.mark.skipif(not SHARED.exists(), reason='needs ../shared/data, which is absent')
def test_a_real_recording() -> None:
    sequence = open_sequence(SHARED / 'fr1_xyz')
    assert len(sequence) == 792
    assert sequence.camera.fx_px == 517.306408
    assert sequence.ground_truth is not None
    assert len(sequence.ground_truth) == 3000
    frame = next(iter(sequence))
    assert frame.stamp_ns == 1_305_031_102_175_304_000
    assert frame.image_bgr.shape == (480, 640, 3)
    assert 0.4 < np.median(frame.depth_m[frame.depth_m > 0]) < 2.0
