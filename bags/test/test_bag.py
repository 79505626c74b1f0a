from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.info import describe, summarize
from hoid_bags.convert import ConvertConfig, convert
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bags.storage import bag_types
from hoid_bags.storage.bag_types import ensure_type, message_class, serialize, shared_typestore
from hoid_common.errors import InputError
from hoid_common.values import CameraModel, Detections

FolderMaker = Callable[..., Path]
WIDTH, HEIGHT = 32, 24
STEP_NS = 33_000_000


def write_frames(
    path: Path,
    names: dict[str, str],
    camera: CameraModel,
    *,
    extra: Callable[[BagWriter, int], None] | None = None,
) -> Path:
    """Write three frames on the topics `names`, whose keys are color, depth, info and others."""
    kinds = {'color': bag_types.IMAGE, 'depth': bag_types.IMAGE, 'info': bag_types.CAMERA_INFO}
    with BagWriter(path) as writer:
        for key, name in names.items():
            writer.add_topic(name, kinds[key.rstrip('2')])
        for i in range(3):
            t_ns = 10**9 + i * STEP_NS
            for key, name in names.items():
                writer.write(name, t_ns, frame_message(key.rstrip('2'), t_ns, camera))
            if extra is not None:
                extra(writer, t_ns)
    return path


def frame_message(key: str, t_ns: int, camera: CameraModel) -> bag_types.Message:
    if key == 'info':
        return bag_messages.camera_info(t_ns, camera)
    if key == 'depth':
        return bag_messages.image(t_ns, np.full((HEIGHT, WIDTH), 1500, np.uint16), '16UC1')
    return bag_messages.image(t_ns, np.full((HEIGHT, WIDTH, 3), 7, np.uint8), 'rgb8')


def assert_three_frames(sequence: Sequence, camera: CameraModel) -> None:
    frames = list(sequence)
    assert [f.stamp_ns for f in frames] == [10**9 + i * STEP_NS for i in range(3)]
    assert all((f.depth_m == np.float32(1.5)).all() for f in frames)
    assert all((f.image_bgr == 7).all() for f in frames)
    assert sequence.camera == camera


@pytest.mark.parametrize(
    'config',
    [
        ConvertConfig(),
        ConvertConfig(compress=True),
        ConvertConfig(rgb='png', depth='png', depth_units_per_m=1000.0),
        ConvertConfig(depth_units_per_m=1000.0),
    ],
)
def test_a_bag_gives_the_frames_of_its_folder(
    make_folder: FolderMaker,
    with_truth: Callable[[Path], Path],
    camera: CameraModel,
    tmp_path: Path,
    config: ConvertConfig,
) -> None:
    folder = with_truth(make_folder(5))
    convert(folder, tmp_path / 'bag', config, camera)
    expected = open_sequence(folder, camera, config.depth_units_per_m or None)
    sequence = open_sequence(tmp_path / 'bag')
    assert sequence.name == 'bag'
    assert sequence.camera == camera
    assert sequence.fault is None
    assert sequence.true_detections is None
    assert len(sequence) == len(expected) == 5
    for _ in range(2):
        for ours, theirs in zip(sequence, expected, strict=True):
            assert ours.stamp_ns == theirs.stamp_ns
            np.testing.assert_array_equal(ours.image_bgr, theirs.image_bgr)
            np.testing.assert_array_equal(ours.depth_m, theirs.depth_m)
    assert sequence.ground_truth is not None
    assert expected.ground_truth is not None
    np.testing.assert_array_equal(sequence.ground_truth.stamps_ns, expected.ground_truth.stamps_ns)
    np.testing.assert_allclose(
        sequence.ground_truth.T_world_camera, expected.ground_truth.T_world_camera, atol=1e-12
    )


@pytest.mark.parametrize(
    'names',
    [
        {'color': '/r1/rgb/image', 'depth': '/r1/depth/image', 'info': '/r1/rgb/camera_info'},
        {'color': '/c/color/image_raw', 'depth': '/d/image_rect', 'info': '/c/color/camera_info'},
        {'color': '/a', 'depth': '/b', 'info': '/c'},
        {
            'color': '/camera/color/image_raw',
            'color2': '/camera/infra1/image_rect_raw',
            'depth': '/camera/aligned_depth_to_color/image_raw',
            'depth2': '/camera/depth/image_rect_raw',
            'info': '/camera/color/camera_info',
            'info2': '/camera/depth/camera_info',
        },
    ],
)  # fmt: skip
def test_topics_are_found_under_other_names(
    tmp_path: Path, camera: CameraModel, names: dict[str, str]
) -> None:
    assert_three_frames(open_sequence(write_frames(tmp_path / 'bag', names, camera)), camera)


def test_several_that_could_be_meant(tmp_path: Path, camera: CameraModel) -> None:
    names = {'color': '/left/image', 'color2': '/right/image', 'depth': '/d', 'info': '/i'}
    path = write_frames(tmp_path / 'bag', names, camera)
    with pytest.raises(InputError, match='several topics could be color: /left/image'):
        open_sequence(path)


@pytest.mark.parametrize(('left_out', 'expected'), [('depth', 'depth'), ('color', 'color')])
def test_images_that_are_missing(
    tmp_path: Path, camera: CameraModel, left_out: str, expected: str
) -> None:
    names = {'color': '/rgb/image', 'depth': '/depth/image', 'info': '/rgb/camera_info'}
    del names[left_out]
    path = write_frames(tmp_path / 'bag', names, camera)
    with pytest.raises(InputError, match=f'has no {expected} images'):
        open_sequence(path)


def test_a_bag_without_camera_needs_one(tmp_path: Path, camera: CameraModel) -> None:
    path = write_frames(tmp_path / 'bag', {'color': '/rgb/image', 'depth': '/d'}, camera)
    with pytest.raises(InputError, match='no camera_info of the color images; give --calibration'):
        open_sequence(path)
    assert_three_frames(open_sequence(path, camera), camera)


def test_other_topics_are_ignored_even_of_unknown_type(
    tmp_path: Path, camera: CameraModel
) -> None:
    path = tmp_path / 'bag'
    names = {'color': '/rgb/image', 'depth': '/depth/image', 'info': '/rgb/camera_info'}
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        odd = writer.add_connection('/odd', 'no_msgs/msg/No', msgdef='int8 x', rihs01='RIHS01_0')
        for key, name in names.items():
            kind = bag_types.CAMERA_INFO if key == 'info' else bag_types.IMAGE
            link = writer.add_connection(name, kind, typestore=shared_typestore())
            for i in range(3):
                t_ns = 10**9 + i * STEP_NS
                message = frame_message(key, t_ns, camera)
                writer.write(link, t_ns + 5_000_000, serialize(message, kind))
                writer.write(odd, t_ns, b'\x00\x01\x00\x00\x01')
    assert_three_frames(open_sequence(path), camera)  # SQLite, as rosbag2 writes on request
    assert '/odd' in describe(summarize(path))


def test_true_detections(tmp_path: Path, camera: CameraModel) -> None:
    names = {'color': '/rgb/image', 'depth': '/depth/image', 'info': '/rgb/camera_info'}

    def extra(writer: BagWriter, t_ns: int) -> None:
        if t_ns == 10**9:
            writer.add_topic('detections_gt', bag_types.DETECTION_ARRAY)
        boxes = np.array([[1, 2, 3.5, 4], [5, 6, 7, 8]], np.float32)
        seen = Detections(t_ns, boxes, ('person', 'cup'), np.array([1, 0.5], np.float32))
        writer.write('detections_gt', t_ns, bag_messages.detection_array(seen, camera))

    exact = open_sequence(
        write_frames(tmp_path / 'bag', names, camera, extra=extra)
    ).true_detections
    assert exact is not None
    assert list(exact) == [10**9 + i * STEP_NS for i in range(3)]
    second = exact[10**9 + STEP_NS]
    assert second.class_names == ('person', 'cup')
    assert second.boxes_xyxy_px.tolist() == [[1, 2, 3.5, 4], [5, 6, 7, 8]]
    assert second.scores.tolist() == [1.0, 0.5]


@pytest.mark.parametrize(
    ('stamps_ns', 'used_ns', 'expected'),
    [
        ([10, 20, 20, 30], [10, 20, 30], 'repeated stamps left out: 1'),
        ([10, 30, 20, 40], [10, 20, 30, 40], 'late stamps sorted in: 1'),
        ([10, 5 * 10**9, 6 * 10**9, 10, 20], [10, 5 * 10**9, 6 * 10**9], 'time starts anew'),
    ],
)
def test_stamps_that_go_backwards(
    tmp_path: Path,
    camera: CameraModel,
    caplog: pytest.LogCaptureFixture,
    stamps_ns: list[int],
    used_ns: list[int],
    expected: str,
) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('rgb/image', bag_types.IMAGE)
        writer.add_topic('depth/image', bag_types.IMAGE)
        for i, t_ns in enumerate(stamps_ns):
            for key in ('color', 'depth'):
                name = 'rgb/image' if key == 'color' else 'depth/image'
                writer.write(name, 10**9 + i, frame_message(key, t_ns, camera))
    sequence = open_sequence(tmp_path / 'bag', camera)
    assert [frame.stamp_ns for frame in sequence] == used_ns
    assert expected in caplog.text


@pytest.mark.parametrize(
    ('field', 'value', 'expected'),
    [
        ('k', np.zeros(9), 'has fx=0.0 fy=0.0 at 32x24 px; is the camera calibrated'),
        ('k', np.full(9, np.nan), 'is the camera calibrated'),
        ('distortion_model', 'fisheye', 'distortion_model "fisheye"; use one of plumb_bob'),
    ],
)
def test_camera_info_that_says_too_little(
    tmp_path: Path, camera: CameraModel, field: str, value: Any, expected: str
) -> None:
    def changed(writer: BagWriter, t_ns: int) -> None:
        message = bag_messages.camera_info(t_ns, camera)
        setattr(message, field, value)
        if t_ns == 10**9:
            writer.add_topic('rgb/camera_info', bag_types.CAMERA_INFO)
        writer.write('rgb/camera_info', t_ns, message)

    names = {'color': '/rgb/image', 'depth': '/depth/image'}
    path = write_frames(tmp_path / 'bag', names, camera, extra=changed)
    with pytest.raises(InputError, match=f'bag: /rgb/camera_info: camera_info .*{expected}'):
        open_sequence(path)
    assert open_sequence(path, camera).camera == camera


def test_image_that_contradicts_itself(tmp_path: Path, camera: CameraModel) -> None:
    names = {'color': '/rgb/image', 'depth': '/depth/image', 'info': '/rgb/camera_info'}
    with BagWriter(tmp_path / 'bag') as writer:
        for key, name in names.items():
            kind = bag_types.CAMERA_INFO if key == 'info' else bag_types.IMAGE
            writer.add_topic(name, kind)
            message = frame_message(key, 10**9, camera)
            if key == 'color':
                message.data = message.data[:-1]
            writer.write(name, 10**9, message)
    with pytest.raises(InputError, match='/rgb/image at 1000000000 ns: rgb8 image has 2303 bytes'):
        list(open_sequence(tmp_path / 'bag'))


def test_summary_in_numbers(bag: Path) -> None:
    summary = summarize(bag)
    assert summary.num_messages == 180
    assert summary.duration_s == pytest.approx(59 * 0.033333333 + 0.005000001, abs=1e-9)
    assert [topic.name for topic in summary.topics] == [
        '/depth/image', '/rgb/camera_info', '/rgb/image',
    ]  # fmt: skip
    assert all(topic.num_messages == 60 for topic in summary.topics)
    assert all(topic.rate_hz == pytest.approx(30.0, abs=1e-3) for topic in summary.topics)
    assert '/rgb/image' in describe(summary)


@pytest.mark.parametrize(
    'name',
    ['no_msgs/msg/No', 'sensor_msgs/msg/No', 'nonsense', '', '../msg/x', 'x' * 300 + '/msg/X'],
)
def test_unknown_types(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match='not known here'):
        ensure_type(name)
    with pytest.raises(InputError, match=f'topic "/t" has type "{name}", which is not known here'):
        message_class('/t', name)
    with pytest.raises(InputError), BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('t', name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('key', ['color', 'depth', 'info', 'truth'])
@pytest.mark.parametrize('kept', [0, 1, 8, 12, 20])
def test_a_message_that_is_none(tmp_path: Path, camera: CameraModel, key: str, kept: int) -> None:
    names = {
        'color': '/rgb/image', 'depth': '/depth/image', 'info': '/rgb/camera_info',
        'truth': '/ground_truth',
    }  # fmt: skip
    kinds = [bag_types.IMAGE, bag_types.IMAGE, bag_types.CAMERA_INFO, bag_types.POSE_STAMPED]
    with BagWriter(tmp_path / 'bag') as writer:
        for name, kind in zip(names.values(), kinds, strict=True):
            writer.add_topic(name, kind)
        for other, name in names.items():
            if other == 'truth':
                message = bag_messages.pose_stamped(10**9, np.eye(4))
            else:
                message = frame_message(other, 10**9, camera)
            kind = kinds[list(names).index(other)]
            data = bytes(serialize(message, kind))
            writer.write_serialized(name, 10**9, data[:kept] if other == key else data)
    if key == 'truth':
        assert open_sequence(tmp_path / 'bag').ground_truth is None
        return
    with pytest.raises(InputError, match=f'{names[key]}.*bytes (are no|has no)'):
        list(open_sequence(tmp_path / 'bag'))


def test_truth_that_is_no_pose(
    tmp_path: Path, camera: CameraModel, caplog: pytest.LogCaptureFixture
) -> None:
    def pose(writer: BagWriter, t_ns: int) -> None:
        message = bag_messages.pose_stamped(t_ns, np.eye(4))
        message.pose.orientation.w = 0.0
        if t_ns == 10**9:
            writer.add_topic('ground_truth', bag_types.POSE_STAMPED)
        writer.write('ground_truth', t_ns, message)

    names = {'color': '/rgb/image', 'depth': '/depth/image', 'info': '/rgb/camera_info'}
    path = write_frames(tmp_path / 'bag', names, camera, extra=pose)
    assert open_sequence(path).ground_truth is None
    assert '3 messages left out' in caplog.text
