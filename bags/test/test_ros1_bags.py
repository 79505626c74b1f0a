"""ROS 1 bags: run, convert, info and play read them as they are."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.info import describe, summarize
from hoid_bags.bag.repair import copy_bag
from hoid_bags.live.playback import PlayConfig, open_plan
from hoid_bags.sequence import open_sequence
from hoid_bags.storage.bag_types import CAMERA_INFO, IMAGE
from hoid_common.errors import InputError
from hoid_common.values import CameraModel

from .bag_copies import read_messages
from .ros1_bags import ros1_copy

CAMERA = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)
VIEWER = '/device_0/sensor_0/Depth_0/image/data'


@pytest.mark.parametrize('compression', ['', 'bz2', 'lz4'])
def test_a_ros1_bag_is_the_same_recording(
    whole_bag: Path, tmp_path: Path, compression: str, big_camera: CameraModel
) -> None:
    path = ros1_copy(whole_bag, tmp_path / 'a recording.bag', compression)
    before, after = open_sequence(whole_bag), open_sequence(path)
    assert after.camera == big_camera
    assert after.fault is None
    for ours, theirs in zip(after, before, strict=True):
        assert ours.stamp_ns == theirs.stamp_ns
        np.testing.assert_array_equal(ours.image_bgr, theirs.image_bgr)
        np.testing.assert_array_equal(ours.depth_m, theirs.depth_m)


def test_info_lists_every_topic_of_a_ros1_bag(whole_bag: Path, tmp_path: Path) -> None:
    summary = summarize(ros1_copy(whole_bag, tmp_path / 'x.bag'))
    assert summary.fault is None
    assert summary.num_messages == 181
    text = describe(summary)
    for topic in summarize(whole_bag).topics:
        assert f'{topic.rate_hz:.2f} Hz' in text
        assert topic.type_name in text
    assert 'dynamic_reconfigure/msg/BoolParameter' in text


def test_a_ros1_bag_is_converted_and_played_message_by_message(
    whole_bag: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = ros1_copy(whole_bag, tmp_path / 'x.bag')
    whole = read_messages(whole_bag)
    assert copy_bag(path, tmp_path / 'copy') is None
    assert read_messages(tmp_path / 'copy') == whole
    played = list(open_plan(path, PlayConfig()).messages(loop=False))
    assert [message.data for message in played] == [message.data for message in whole]
    for record in caplog.records:
        assert record.levelno == logging.WARNING
        assert '1 topics left out, whose types ROS 2 lacks: dynamic_reconfigure/' in record.message
    with pytest.raises(InputError, match='whose types ROS 2 lacks'):
        open_plan(path, PlayConfig(), ('driver/a_parameter/_0',))


@pytest.mark.parametrize(('unit_m', 'count'), [(0.001, 1500), (0.0001, 15000)])
def test_the_depth_unit_that_librealsense_appends_is_used(
    tmp_path: Path, unit_m: float, count: int
) -> None:
    color = '/device_0/sensor_1/Color_0/image/data'
    info = '/device_0/sensor_1/Color_0/info/camera_info'
    with BagWriter(tmp_path / 'bag') as writer:
        for name, kind in ((info, CAMERA_INFO), (color, IMAGE), (VIEWER, IMAGE)):
            writer.add_topic(name, kind)
        writer.write(info, 1, bag_messages.camera_info(1, CAMERA))
        pixels = np.full((24, 32, 3), 90, np.uint8)
        writer.write(color, 2, bag_messages.image(10**9, pixels, 'rgb8'))
        depth = np.full((24, 32), count, np.uint16)
        writer.write(VIEWER, 2, bag_messages.image(10**9, depth, 'mono16'))
    path = ros1_copy(tmp_path / 'bag', tmp_path / 'viewer.bag', 'lz4', unit_m)
    sequence = open_sequence(path)
    (frame,) = sequence
    np.testing.assert_allclose(frame.depth_m, 1.5, rtol=1e-6)
    assert sequence.camera == CAMERA


def test_a_ros1_bag_that_is_damaged_gives_what_is_before_the_damage(
    whole_bag: Path, tmp_path: Path
) -> None:
    path = ros1_copy(whole_bag, tmp_path / 'x.bag', 'bz2')
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 2000] = bytes(2000)
    path.write_bytes(data)
    with BagReader(path) as reader:
        num_read = sum(1 for _ in reader.messages())
        assert 40 < num_read < 140
        assert 'damaged after' in (reader.fault or '')


def test_a_ros1_bag_without_its_index_is_refused_in_one_line(
    whole_bag: Path, tmp_path: Path
) -> None:
    path = ros1_copy(whole_bag, tmp_path / 'x.bag')
    path.write_bytes(path.read_bytes()[:100_000])
    with pytest.raises(InputError, match=r'x\.bag: cannot be read: ') as caught:
        open_sequence(path)
    assert '\n' not in str(caught.value)
    (tmp_path / 'text.bag').write_text('hello')
    with pytest.raises(InputError, match=r'text\.bag: cannot be read: .*magic is invalid'):
        summarize(tmp_path / 'text.bag')
