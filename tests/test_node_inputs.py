"""Inputs of a node: matched, compressed, missing, malformed and incompatible messages."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CompressedImage, Image
from tf2_msgs.msg import TFMessage

from hoid_common.poses.frames import StaticFrames
from hoid_common.ros import conversions, qos
from hoid_common.ros.frame_tree import StaticFrameListener
from hoid_system_tests.sample_bench import SampleBench
from rgbd_slam.ros.motion.wheels import WheelOdometry

IMAGE = np.zeros((4, 6, 3), np.uint8)
MS = 1_000_000


def color(stamp_ms: int) -> Image:
    return conversions.color_to_msg(IMAGE, conversions.header_to_msg(stamp_ms * MS, 'camera'))


def depth(stamp_ms: int) -> Image:
    depth_m = np.ones((4, 6), np.float32)
    return conversions.depth_to_msg(depth_m, conversions.header_to_msg(stamp_ms * MS, 'camera'))


def test_pairs_are_matched_and_other_images_counted_as_dropped(sample: SampleBench) -> None:
    colors = sample.probe.publisher(Image, 'rgb/image')
    depths = sample.probe.publisher(Image, 'depth/image')
    for stamp_ms in (1000, 1033, 1066):
        colors.publish(color(stamp_ms))
    for stamp_ms in (1010, 1076):
        depths.publish(depth(stamp_ms))
    sample.probe.spin_until(lambda: len(sample.node.matches) == 2, 'no two matches')
    assert [match.stamp_ns for match in sample.node.matches] == [1000 * MS, 1066 * MS]
    assert sample.node.matches[0].values[1].header.stamp.nanosec == 10 * MS
    assert (sample.count('color dropped'), sample.count('depth dropped')) == (1, 0)
    assert sample.count('color images received') == 3


def test_an_invalid_image_is_refused_and_the_node_keeps_running(sample: SampleBench) -> None:
    colors = sample.probe.publisher(Image, 'rgb/image')
    depths = sample.probe.publisher(Image, 'depth/image')
    bad = color(1000)
    bad.encoding = 'thermal8'
    colors.publish(bad)
    depths.publish(depth(1000))
    sample.probe.spin_until(lambda: sample.count('color images refused') == 1, 'no image refused')
    colors.publish(color(1033))
    depths.publish(depth(1033))
    sample.probe.spin_until(
        lambda: len(sample.node.matches) == 1, 'no match after the refused image'
    )
    assert sample.count('depth images refused') == 0


def test_a_refused_match_does_not_affect_the_next_one(sample: SampleBench) -> None:
    take_color = sample.node.sync.input('color', conversions.color_from_msg)
    take_depth = sample.node.sync.input('depth', conversions.depth_from_msg)
    small = conversions.color_to_msg(IMAGE[::2], color(1100).header)
    for msg in (depth(1050), depth(1083)):  # the next one is expected at 1116
        take_depth(msg)
    for msg in (small, color(1116)):
        take_color(msg)
    assert sample.node.matches == []
    take_depth(depth(1117))  # completes both matches
    assert [match.stamp_ns for match in sample.node.matches] == [1116 * MS]
    assert sample.count('matched images refused') == 1


def test_compressed_images_are_received_when_the_parameter_is_set(domain_id: int) -> None:
    sample = SampleBench(domain_id, '-p', 'input.compressed:=true')
    colors = sample.probe.publisher(CompressedImage, 'rgb/image/compressed')
    depths = sample.probe.publisher(CompressedImage, 'depth/image/compressedDepth')
    header = conversions.header_to_msg(1000 * MS, 'camera')
    colors.publish(conversions.compressed_color_to_msg(IMAGE, header, quality=90))
    depth_m = np.ones((4, 6), np.float32)
    depths.publish(conversions.compressed_depth_to_msg(depth_m, header))
    sample.probe.spin_until(lambda: len(sample.node.matches) == 1, 'no match')
    sample.close()


def test_missing_inputs_are_reported(sample: SampleBench) -> None:
    received = sample.probe.collect(DiagnosticArray, '/diagnostics')
    complaint = 'on /depth/image: no publisher'
    sample.probe.spin_until(
        lambda: any(complaint in msg.status[0].message for msg in received),
        'no warning is published',
    )
    status = received[-1].status[0]
    assert (status.level, status.name) == (DiagnosticStatus.WARN, '/sample')
    assert 'no color images yet for' in status.message


def test_a_qos_mismatch_is_reported(domain_id: int) -> None:
    sample = SampleBench(domain_id, '-p', 'input.reliability:=reliable')
    sample.probe.publisher(Image, 'depth/image', qos.input_qos('best_effort', 1), wait=False)
    expected = (
        'on /depth/image: 1 publisher, reliability best_effort, '
        'but the subscription requests reliable'
    )
    sample.probe.spin_until(lambda: expected in sample.status().message, 'no warning is published')
    sample.close()


def test_compressed_images_are_requested_reliably_if_all_publishers_offer_it(
    domain_id: int,
) -> None:
    sample = SampleBench(domain_id, '-p', 'input.compressed:=true')
    topic = '/depth/image/compressedDepth'

    def requested() -> list[str]:
        found = sample.node.get_subscriptions_info_by_topic(topic)
        return [info.qos_profile.reliability.name for info in found]

    sample.probe.publisher(CompressedImage, topic)
    assert requested() == ['RELIABLE']
    offers_less = qos.input_qos('best_effort', 1)
    weak = sample.probe.publisher(CompressedImage, topic, offers_less, wait=False)
    sample.probe.spin_until(lambda: requested() == ['BEST_EFFORT'], 'reliability is not relaxed')
    sample.probe.spin_until(lambda: weak.get_subscription_count() > 0, 'no subscription')
    weak.publish(CompressedImage())
    sample.probe.spin_until(
        lambda: sample.count('depth images refused') == 1, 'no message is received'
    )
    sample.close()


@pytest.mark.parametrize(
    'data',
    [b'', b'\x00\x01\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 60, b'\xff' * 20],
)
def test_malformed_images_are_counted_and_logged_with_their_topic(
    sample: SampleBench, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    publisher = sample.probe.publisher(Image, 'rgb/image')
    for _ in range(5):
        publisher.publish(data)
    sample.probe.spin_until(lambda: sample.count('color images refused') == 5, 'not counted')
    sample.probe.publisher(Image, 'depth/image')
    lines = [
        line for line in capfd.readouterr().err.splitlines() if 'no sensor_msgs/Image' in line
    ]
    assert len(lines) == 1  # throttled
    assert f'/rgb/image: {len(data)} bytes are no sensor_msgs/Image' in lines[0]


def test_an_oversized_message_is_refused_without_decoding(
    sample: SampleBench, capfd: pytest.CaptureFixture[str]
) -> None:
    listener = StaticFrameListener(sample.node, sample.node.diagnostics)
    publisher = sample.probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    publisher.publish(b'\x00\x01\x00\x00' + bytes(2_000_000))
    sample.probe.spin_until(lambda: sample.count('static transforms refused') == 1, 'not counted')
    assert '/tf_static: message of 2000004 bytes exceeds 2000000 bytes' in capfd.readouterr().err
    assert listener.frames.find('base', 'camera') is None


def test_malformed_static_transforms_are_counted_and_logged(
    sample: SampleBench, capfd: pytest.CaptureFixture[str]
) -> None:
    listener = StaticFrameListener(sample.node, sample.node.diagnostics)
    publisher = sample.probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    for data in (b'\x00\x01\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 60, b'\xff'):
        publisher.publish(data)
    edge = conversions.transform_to_msg(np.eye(4), 0, 'base', 'camera')
    publisher.publish(TFMessage(transforms=[edge]))
    sample.probe.spin_until(
        lambda: listener.frames.find('base', 'camera') is not None, 'no static transform'
    )
    assert sample.count('static transforms refused') == 3
    lines = [line for line in capfd.readouterr().err.splitlines() if 'TFMessage' in line]
    assert len(lines) == 1
    assert '/tf_static: 4 bytes are no tf2_msgs/TFMessage' in lines[0]


def test_more_than_16_children_of_odom_are_refused(
    sample: SampleBench, capfd: pytest.CaptureFixture[str]
) -> None:
    static = StaticFrames()
    wheels = WheelOdometry(sample.node, 'odom', static, sample.node.diagnostics)
    publisher = sample.probe.publisher(TFMessage, '/tf', qos.TF)
    for n in range(20):
        edge = conversions.transform_to_msg(np.eye(4), MS, 'odom', f'base_{n}')
        publisher.publish(TFMessage(transforms=[edge]))
    sample.probe.spin_until(lambda: sample.count('transforms refused') == 4, 'not counted')
    assert wheels.at(MS, 'base_15') is not None
    assert wheels.at(MS, 'base_16') is None
    lines = [line for line in capfd.readouterr().err.splitlines() if 'children of odom' in line]
    assert len(lines) == 1
    assert 'children of odom: frame "base_16" exceeds the limit of 16 frames;' in lines[0]
