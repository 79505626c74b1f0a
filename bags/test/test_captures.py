"""Recordings of phones, scanners and renderers: images, depth in meters, poses and IMU."""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.convert import convert
from hoid_bags.imu_recording import read_own_imu
from hoid_bags.sequence import open_sequence
from hoid_bags.tum.exr import decode_exr
from hoid_bags.tum.layouts import LAYOUTS
from hoid_bags.tum.sens import SensFile
from hoid_common.errors import InputError
from hoid_common.values import CameraModel

from . import recordings as made
from .recordings import NUM, POSES

G_MPS2 = 9.80665
ICL = CameraModel(640, 480, 481.2, 480.0, 319.5, 239.5)
PHONE_DEPTH_M = np.repeat(np.repeat(made.PHONE_DEPTH_MM, 3, axis=0), 3, axis=1) / 1000
TRUSTED_M = PHONE_DEPTH_M.copy()
TRUSTED_M[:3, :3] = 0
# The depth camera sees more than color: 57 and 60 px of focal length.
WALL_M = np.full((48, 64), made.SENS_MM / 1000)
OF_PHONE = tuple(made.STAMPS_S)
OF_NUMBERS = tuple(1 + i / 30 for i in range(NUM + 1))


class Capture(NamedTuple):
    write: Callable[[Path], None]
    told: str  # of what was taken for what
    camera: CameraModel
    depth_m: NDArray[np.floating]
    stamps_s: tuple[float, ...]
    poses: tuple[int, ...] = (0, 1, 2, 3)  # those that are known
    imu: tuple[tuple[float, ...] | None, tuple[float, ...] | None] = (None, None)


RATES = 0.1, 0.2, 0.3
CAPTURES = {
    'Record3D': Capture(
        made.record3d,
        'Record3D layout: color rgb/* (4), depth depth/*.exr (4, 1 units per meter), camera '
        '192x144 fx 180.0, truth metadata.json, color scaled to a multiple of the size of depth',
        made.PHONE_SHRUNK, PHONE_DEPTH_M, OF_PHONE,
    ),
    'Stray Scanner': Capture(
        made.stray,
        'Stray Scanner layout: color rgb.mp4 (4), depth depth/*.png (4, 1000 units per meter), '
        'camera 192x144 fx 180.0, truth odometry.csv, IMU imu.csv, color scaled to a multiple of '
        'the size of depth',
        made.PHONE_SHRUNK, TRUSTED_M, OF_PHONE, imu=(RATES, (0, 0, G_MPS2)),
    ),
    'ScanNet': Capture(
        made.sens,
        'ScanNet layout: color *.sens (4), depth *.sens (4, 1 units per meter), camera 64x48 '
        'fx 60.0, truth scene0000_00.sens, IMU *.sens, color scaled to a multiple of the size of '
        'depth, to which it is mapped',
        made.SENS_SHRUNK, WALL_M, OF_PHONE, (0, 1, 3), (RATES, None),
    ),
    'ICL-NUIM': Capture(
        made.icl_nuim,
        'ICL-NUIM layout: color associations.txt (4), depth associations.txt (4, 5000 units per '
        'meter), camera 640x480 fx 481.2, truth livingRoom1.gt.freiburg, '
        'stamps of an assumed 30 Hz',
        ICL, made.ICL_DEPTH_M, OF_NUMBERS[1:],
    ),
    'ICL-NUIM of POV-Ray': Capture(
        made.icl_scene,
        'ICL-NUIM of POV-Ray layout: color scene_*.png (4), depth scene_*.depth (4, 1 units per '
        'meter), camera 640x480 fx 481.2, truth scene_00_0000.txt, stamps of an assumed 30 Hz',
        ICL, made.ICL_DEPTH_M, OF_NUMBERS[:-1],
    ),
}  # fmt: skip


@pytest.fixture(params=CAPTURES)
def case(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Capture, Path]:
    capture = CAPTURES[request.param]
    if capture.write is made.stray:
        pytest.importorskip('av', reason='an optional extra: requirements/video.lock')
    folder = tmp_path / 'recording'
    folder.mkdir()
    capture.write(folder)
    return capture, folder


def test_a_capture_is_known_by_its_files_and_converted(
    case: tuple[Capture, Path], tmp_path: Path
) -> None:
    capture, folder = case
    sequence = open_sequence(folder)
    assert str(sequence) == capture.told
    assert sequence.camera.size_px == capture.camera.size_px
    np.testing.assert_allclose(sequence.camera.matrix, capture.camera.matrix, atol=1e-5)
    convert(folder, tmp_path / 'bag')
    for found in (sequence, open_sequence(tmp_path / 'bag')):
        frames = list(found)
        assert len(frames) == NUM
        for i, frame in enumerate(frames):
            assert frame.stamp_ns == pytest.approx(1e9 * capture.stamps_s[i], abs=2000)
            assert np.abs(frame.image_bgr.astype(int) - (50 + 16 * i)).max() <= 5
            np.testing.assert_allclose(frame.depth_m, capture.depth_m, atol=2e-4)
        truth = found.ground_truth
        assert truth is not None
        stamps_s = [capture.stamps_s[i] for i in capture.poses]
        np.testing.assert_allclose(truth.stamps_ns, 1e9 * np.array(stamps_s), atol=2000)
        np.testing.assert_allclose(truth.T_world_camera, POSES[list(capture.poses)], atol=1e-6)


def test_the_imu_of_a_capture_is_taken_along(case: tuple[Capture, Path], tmp_path: Path) -> None:
    capture, folder = case
    convert(folder, tmp_path / 'bag')
    with BagReader(tmp_path / 'bag') as reader:
        names = {topic.name for topic in reader.topics if topic.num_messages}
    assert ('/imu' in names, '/imu/accelerometer' in names) == tuple(
        sensor is not None for sensor in capture.imu
    )
    if capture.imu == (None, None):
        with pytest.raises(InputError, match='has no samples of an IMU'):
            read_own_imu(folder)
        return
    for found in (read_own_imu(folder), read_own_imu(tmp_path / 'bag')):
        for table, expected in zip(found, capture.imu, strict=True):
            assert (table is None) == (expected is None)
            if table is not None and expected is not None:
                np.testing.assert_allclose(table.values, np.tile(expected, (10, 1)), rtol=1e-6)
                np.testing.assert_allclose(
                    table.stamps_ns, 1e9 * (100 + 0.01 * np.arange(10)), atol=2000
                )


def test_a_sens_file_is_read_by_its_own_path_also_when_cut_off(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made.sens(tmp_path, is_packed=False)
    path = tmp_path / 'scene0000_00.sens'
    assert str(open_sequence(path)) == CAPTURES['ScanNet'].told
    assert len(list(open_sequence(path))) == NUM
    data = path.read_bytes()
    path.write_bytes(data[: data.index(struct.pack('<Q', 10), len(data) - 1290) - 100])
    assert len(list(open_sequence(path))) == NUM - 1
    assert 'scene0000_00.sens: cut off after 3 frames' in caplog.text


def test_poses_without_an_image_in_the_video_are_left_out(tmp_path: Path) -> None:
    pytest.importorskip('av', reason='an optional extra: requirements/video.lock')
    made.stray(tmp_path)
    odometry = tmp_path / 'odometry.csv'
    last = odometry.read_text().splitlines()[-1].replace(f'{NUM - 1:06}', f'{NUM:06}')
    odometry.write_text(f'{odometry.read_text()}\n{last.replace("100.05", "100.06")}')
    assert len(list(open_sequence(tmp_path))) == NUM


def test_poses_that_are_none_are_left_out(tmp_path: Path) -> None:
    made.record3d(tmp_path)
    path = tmp_path / 'metadata.json'
    metadata = json.loads(path.read_text())
    metadata['poses'][1] = [0] * 7
    metadata['poses'][2][0] = float('nan')
    path.write_text(json.dumps(metadata))
    sequence = open_sequence(tmp_path)
    assert len(list(sequence)) == NUM
    assert sequence.ground_truth is not None
    np.testing.assert_allclose(sequence.ground_truth.T_world_camera, POSES[[0, 3]], atol=1e-9)


def test_accelerations_without_gravity_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip('av', reason='an optional extra: requirements/video.lock')
    made.stray(tmp_path, gravity=0.02)
    imu = read_own_imu(tmp_path)
    assert imu.rates is not None
    assert imu.accelerations is None
    assert 'accelerations are not in g with gravity and are left out' in caplog.text


@pytest.mark.parametrize('compression', [0, 2, 3])
@pytest.mark.parametrize('kinds', ['f', 'e', 'efe'])
def test_exr_images_are_read(compression: int, kinds: str) -> None:
    depth_m = (np.arange(37 * 50) % 512 / 128).reshape(37, 50).astype(np.float32)
    data = made.exr(depth_m, compression, kinds)
    np.testing.assert_array_equal(decode_exr(data, 'x'), depth_m)


def test_exr_images_of_ffmpeg_are_read() -> None:
    av = pytest.importorskip('av', reason='an optional extra: requirements/video.lock')
    depth_m = (np.arange(37 * 50) % 500 / 100).reshape(37, 50).astype(np.float32)
    for name in ('none', 'zip1', 'zip16'):
        encoder = av.CodecContext.create('exr', 'w')
        encoder.width, encoder.height, encoder.pix_fmt = 50, 37, 'grayf32le'
        encoder.time_base, encoder.options = 1, {'compression': name, 'format': 'float'}
        frame = av.VideoFrame.from_ndarray(depth_m, format='grayf32le')
        (packet,) = encoder.encode(frame)
        np.testing.assert_array_equal(decode_exr(bytes(packet), 'x'), depth_m)


def test_the_document_lists_every_layout() -> None:
    text = (Path(__file__).resolve().parents[2] / 'docs/howto/bags.md').read_text()
    listed = re.findall(r'^\| ([^|]+) \|', text.partition('## Folders')[2], re.MULTILINE)
    for layout in LAYOUTS:
        assert any(row.startswith(layout.name) for row in listed), layout.name


def refused(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        list(open_sequence(folder))
    assert '\n' not in str(caught.value)
    return str(caught.value)


def test_damaged_exr_images_are_refused() -> None:
    data = made.exr(np.ones((37, 50), np.float32), 3)
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(data[: rng.integers(len(data))] if rng.random() < 0.5 else data)
        for at in rng.integers(0, max(len(damaged), 1), 3):
            damaged[at : at + 1] = bytes([rng.integers(256)])
        with suppress(InputError):
            assert decode_exr(bytes(damaged), 'x').size <= 50_000_000


def test_exr_blocks_beside_the_image_are_refused_without_being_unpacked() -> None:
    data = made.exr(np.ones((16, 50), np.float32), 3)
    at = next(k for k in range(8, len(data)) if data[k - 8 : k] == k.to_bytes(8, 'little'))
    first_row = struct.unpack_from('<i', data, at)[0]
    bomb = zlib.compress(bytes(1_000_000))
    beside = data[:at] + struct.pack('<iI', first_row + 16, len(bomb)) + bomb
    far = data[: at - 8] + b'\xff' * 8 + data[at:]
    for damaged in (beside, far):
        with pytest.raises(InputError, match='damaged EXR image'):
            decode_exr(damaged, 'x')


def test_a_sens_file_with_an_impossible_stamp_has_those_of_its_rate(tmp_path: Path) -> None:
    made.sens(tmp_path)
    path = tmp_path / 'scene0000_00.sens'
    first = SensFile(path).frames[0]
    data = bytearray(path.read_bytes())
    data[first.color_at - 32 : first.color_at - 24] = (2**62).to_bytes(8, 'little')
    path.write_bytes(data[: first.color_at + first.color_bytes + first.depth_bytes])
    assert [frame.stamp_ns for frame in open_sequence(path)] == [10**9]


def test_other_text_files_beside_the_poses_of_icl_nuim_are_ignored(tmp_path: Path) -> None:
    made.icl_scene(tmp_path)
    (tmp_path / 'scene_readme.txt').write_text('about the scene')
    truth = open_sequence(tmp_path).ground_truth
    assert truth is not None
    assert len(truth) == NUM


def test_captures_that_cannot_be_read_are_refused_in_one_line(tmp_path: Path) -> None:
    made.record3d(tmp_path)
    (tmp_path / 'depth/2.exr').write_bytes(made.exr(np.ones((48, 64), np.float32), 3)[:-30])
    assert 'damaged EXR image' in refused(tmp_path)
    (tmp_path / 'depth/2.exr').unlink()
    assert 'lacks image 2 of metadata.json' in refused(tmp_path)
    (tmp_path / 'metadata.json').write_text('{"poses": []}')
    assert 'w must be a number, got None' in refused(tmp_path)
    (tmp_path / 'metadata.json').write_text(f'{{"w": {10**400}}}')
    assert 'w is too large a number' in refused(tmp_path)


def test_a_number_of_an_image_has_an_end(tmp_path: Path) -> None:
    made.icl_nuim(tmp_path)
    path = tmp_path / 'associations.txt'
    path.write_text(path.read_text().replace('4 rgb/4.png', f'{10**20} rgb/4.png'))
    assert '100000000000000000000 is no number of an image' in refused(tmp_path)
    path.write_text('1 depth/1.png 1 rgb/9.png')
    assert 'expected a number and a file, twice' in refused(tmp_path)


def test_a_packed_recording_of_record3d_is_refused_with_the_way_out(tmp_path: Path) -> None:
    (tmp_path / 'room.r3d').touch()
    for path in (tmp_path, tmp_path / 'room.r3d'):
        assert 'packed with LZFSE; export the recording as "EXR + RGB"' in refused(path)


def test_damaged_sens_files_are_refused_or_read_in_part(tmp_path: Path) -> None:
    made.sens(tmp_path)
    path = tmp_path / 'scene0000_00.sens'
    data, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(100):
        damaged = bytearray(data[: rng.integers(len(data))] if rng.random() < 0.5 else data)
        for at in rng.integers(0, min(len(damaged), 700) or 1, 4):
            damaged[at : at + 1] = bytes([rng.integers(256)])
        path.write_bytes(bytes(damaged))
        with suppress(InputError):
            assert len(list(open_sequence(path))) <= NUM
