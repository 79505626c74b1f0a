from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader

from hoid_bags.bag.encoding import first_not_whole_mm
from hoid_bags.convert import ConvertConfig, convert
from hoid_bags.storage.bag_types import deserialize
from hoid_bags.tum.tum_folder import open_tum_folder
from hoid_common.errors import InputError
from hoid_common.io.compression.compressed_images import decode_compressed_depth
from hoid_common.values import CameraModel

FolderMaker = Callable[..., Path]
MM = ConvertConfig(depth_units_per_m=1000.0)


def read_with_rosbags(bag: Path) -> list[tuple[str, str, int, object]]:
    with Reader(bag) as reader:
        return [
            (connection.topic, connection.msgtype, log_ns, deserialize(data, connection.msgtype))
            for connection, log_ns, data in reader.messages()
        ]


def read_with_mcap(bag: Path) -> list[tuple[str, str, int, object]]:
    with next(bag.glob('*.mcap')).open('rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == 'ros2'
        return [
            (channel.topic, schema.name, message.log_time, decoded)
            for schema, channel, message, decoded in reader.iter_decoded_messages()
            if schema is not None
        ]


def on(messages: list[tuple[str, str, int, object]], topic: str) -> list[Any]:
    return [message for name, _, _, message in messages if name == topic]


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


@pytest.mark.parametrize('compress', [False, True])
def test_two_libraries_read_the_same_back(
    make_folder: FolderMaker,
    with_truth: Callable[[Path], Path],
    camera: CameraModel,
    tmp_path: Path,
    compress: bool,
) -> None:
    folder = with_truth(make_folder(4))
    bag = tmp_path / 'out' / 'bag'
    convert(folder, bag, ConvertConfig(compress=compress), camera)
    first, second = read_with_rosbags(bag), read_with_mcap(bag)
    assert [row[:3] for row in first] == [row[:3] for row in second]
    counts = {name: sum(row[0] == name for row in first) for name in {row[0] for row in first}}
    assert counts == {
        '/rgb/image': 4,
        '/rgb/camera_info': 4,
        '/depth/image': 4,
        '/ground_truth': 2,
        '/imu/accelerometer': 1,
    }
    assert [log_ns for _, _, log_ns, _ in first] == sorted(log_ns for _, _, log_ns, _ in first)
    source = open_tum_folder(folder, camera)
    for messages in (first, second):
        for listed, message in zip(source.color, on(messages, '/rgb/image'), strict=True):
            assert stamp_ns(message) == listed.stamp_ns
            assert (message.encoding, message.step) == ('bgr8', 32 * 3)
            pixels = np.frombuffer(message.data, np.uint8).reshape(24, 32, 3)
            np.testing.assert_array_equal(pixels, cv2.imread(str(listed.path)))
        for listed, message in zip(source.depth, on(messages, '/depth/image'), strict=True):
            assert stamp_ns(message) == listed.stamp_ns
            assert message.encoding == '32FC1'
            depth_m = np.frombuffer(message.data, np.float32).reshape(24, 32)
            units = cv2.imread(str(listed.path), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(np.rint(depth_m * 5000.0), units)
        info = on(messages, '/rgb/camera_info')[0]
        np.testing.assert_array_equal(np.array(info.k).reshape(3, 3), camera.matrix)
        assert tuple(info.d) == camera.distortion
        pose = on(messages, '/ground_truth')[0].pose
        assert (pose.position.x, pose.position.y, pose.position.z) == (1.5, -0.25, 2.0)
        imu = on(messages, '/imu/accelerometer')[0]
        assert imu.linear_acceleration.y == 8.01056
        assert imu.orientation_covariance[0] == -1.0
        assert stamp_ns(imu) == 1_305_031_102_176_000_001


def test_a_gyro_is_carried_on_the_topic_of_the_imu(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path
) -> None:
    folder, bag = make_folder(2), tmp_path / 'bag'
    (folder / 'gyro.txt').write_text('1305031102.18 0.1 -0.2 0.3\n1305031102.185 0.4 0.5 0.6\n')
    convert(folder, bag, None, camera)
    first, second = on(read_with_rosbags(bag), '/imu')
    assert stamp_ns(first) == 1_305_031_102_180_000_000
    rate = second.angular_velocity
    assert (rate.x, rate.y, rate.z) == (0.4, 0.5, 0.6)
    assert first.angular_velocity_covariance[0] == 0.0
    assert first.orientation_covariance[0] == first.linear_acceleration_covariance[0] == -1.0


def test_metadata_is_that_of_jazzy(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    convert(make_folder(2), bag, None, camera)
    loaded = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert loaded['version'] == 9
    assert loaded['storage_identifier'] == 'mcap'
    assert loaded['relative_file_paths'] == ['bag.mcap']
    assert loaded['message_count'] == 6
    topic = loaded['topics_with_message_count'][0]['topic_metadata']
    assert topic['name'] == '/rgb/camera_info'
    assert topic['serialization_format'] == 'cdr'
    assert topic['type_description_hash'].startswith('RIHS01_')
    (profile,) = topic['offered_qos_profiles']
    assert (profile['reliability'], profile['durability']) == ('reliable', 'volatile')


def test_a_camera_comes_before_its_image(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path
) -> None:
    convert(make_folder(2), tmp_path / 'bag', None, camera)
    names = [row[0] for row in read_with_rosbags(tmp_path / 'bag')]
    assert names == ['/depth/image', '/rgb/camera_info', '/rgb/image'] * 2


@pytest.mark.parametrize(('ext', 'encoding'), [('jpg', 'jpeg'), ('png', 'png')])
def test_files_of_the_encoding_asked_for_stay_as_they_are(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path, ext: str, encoding: str
) -> None:
    folder = make_folder(2, ext=ext)
    convert(folder, tmp_path / 'bag', ConvertConfig(rgb=encoding), camera)
    files = sorted((folder / 'rgb').iterdir())
    messages = on(read_with_mcap(tmp_path / 'bag'), '/rgb/image/compressed')
    assert [bytes(message.data) for message in messages] == [f.read_bytes() for f in files]
    assert messages[0].format == f'bgr8; {encoding} compressed bgr8'


@pytest.mark.parametrize(('ext', 'encoding'), [('jpg', 'png'), ('png', 'jpeg')])
def test_files_of_another_encoding_are_encoded(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path, ext: str, encoding: str
) -> None:
    folder = make_folder(2, ext=ext)
    convert(folder, tmp_path / 'bag', ConvertConfig(rgb=encoding, jpeg_quality=100), camera)
    for listed, message in zip(
        open_tum_folder(folder, camera).color,
        on(read_with_rosbags(tmp_path / 'bag'), '/rgb/image/compressed'),
        strict=True,
    ):
        pixels = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
        written = cv2.imread(str(listed.path))
        assert pixels is not None
        assert written is not None
        off = np.abs(pixels.astype(int) - written).mean()
        assert off == 0 if encoding == 'png' else off < 3


def test_whole_millimeters_become_16uc1(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path
) -> None:
    folder = make_folder(2, depth_step=5)  # of 0.2 mm
    convert(folder, tmp_path / 'bag', None, camera)
    files = sorted((folder / 'depth').iterdir())
    for path, message in zip(
        files, on(read_with_mcap(tmp_path / 'bag'), '/depth/image'), strict=True
    ):
        assert (message.encoding, message.step) == ('16UC1', 64)
        depth_mm = np.frombuffer(message.data, np.uint16).reshape(24, 32)
        np.testing.assert_array_equal(depth_mm * 5, cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize(('units_per_m', 'step'), [(1000.0, 1), (5000.0, 5)])
def test_compressed_depth_is_exact(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path, units_per_m: float, step: int
) -> None:
    folder = make_folder(2, depth_step=step)
    config = ConvertConfig(depth='png', depth_units_per_m=units_per_m)
    convert(folder, tmp_path / 'bag', config, camera)
    frames = list(open_tum_folder(folder, camera, units_per_m))
    messages = on(read_with_rosbags(tmp_path / 'bag'), '/depth/image/compressedDepth')
    for frame, message in zip(frames, messages, strict=True):
        assert message.format == '16UC1; compressedDepth png'
        depth_m = decode_compressed_depth(message.format, message.data)
        np.testing.assert_array_equal(depth_m, frame.depth_m)


def test_compressed_depth_that_would_lose_is_refused_unless_asked_for(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path
) -> None:
    folder, bag = make_folder(2), tmp_path / 'bag'
    with pytest.raises(InputError, match='not in whole millimeters'):
        convert(folder, bag, ConvertConfig(depth='png'), camera)
    assert sorted(p.name for p in tmp_path.iterdir()) == [folder.name]
    convert(folder, bag, ConvertConfig(depth='png', round_depth=True), camera)
    frame = next(iter(open_tum_folder(folder, camera)))
    message = on(read_with_rosbags(bag), '/depth/image/compressedDepth')[0]
    depth_m = decode_compressed_depth(message.format, message.data)
    assert 0 < np.abs(depth_m - frame.depth_m).max() <= 0.0005


def test_millimeters_beyond_16_bits_are_not_whole(
    make_folder: FolderMaker, camera: CameraModel
) -> None:
    listed = open_tum_folder(make_folder(1), camera).depth
    assert first_not_whole_mm(listed, 1000.0) is None
    assert first_not_whole_mm(listed, 100.0) == listed[0].path  # cm, up to 130 m


def test_memory_does_not_grow_with_the_recording(
    make_folder: FolderMaker, big_camera: CameraModel, tmp_path: Path
) -> None:
    def peak_bytes(num_frames: int) -> int:
        folder = make_folder(num_frames, name=f'fr1_{num_frames}', scale=5)
        tracemalloc.start()
        convert(folder, tmp_path / f'bag{num_frames}', MM, big_camera)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    peak_bytes(2)  # types and modules are loaded once
    few, many = peak_bytes(20), peak_bytes(80)
    image_bytes = 60 * 160 * 120 * 5
    assert many - few < 0.05 * image_bytes  # lists and the bag's index are all that grows
