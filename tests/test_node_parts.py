"""Parameters, inputs, diagnostics, logging and the entry point, on a small node."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image
from tf2_msgs.msg import TFMessage

from hoid_common import topics
from hoid_common.config import Config, param
from hoid_common.errors import ConfigError, MessageError
from hoid_common.inputs.input_config import InputConfig
from hoid_common.inputs.input_watch import InputWatch
from hoid_common.ros import conversions, qos
from hoid_common.ros.clocks import ignore_negative_clock_times
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.frame_tree import StaticFrameListener
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.logs import bridge_logging
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.sync import Synchronizer
from hoid_common.static_frames import StaticFrames
from hoid_common.sync import Match, StampMatcher
from hoid_system_tests.probe import Probe
from rgbd_slam.ros.wheels import WheelOdometry

IMAGE = np.zeros((4, 6, 3), np.uint8)
MS = 1_000_000


@dataclass(frozen=True)
class Rule(Config):
    share: float = param(0.5, 'a share', minimum=0.0, maximum=1.0, read_only=False)
    classes: tuple[str, ...] = param((), 'classes', read_only=False)


@dataclass(frozen=True)
class Settings(Config):
    number: int = param(3, 'a number', minimum=1, maximum=9)
    mode: str = param('fast', 'a mode', choices=('fast', 'slow'), read_only=False)
    rule: Rule = field(default_factory=Rule)
    input: InputConfig = field(default_factory=InputConfig)


class Sample(Node):
    """Matches colour and depth, and refuses pictures that cannot be decoded or differ in size."""

    def __init__(self, context: Context, *args: str) -> None:
        super().__init__(
            'sample',
            context=context,
            cli_args=['--ros-args', *args],
            automatically_declare_parameters_from_overrides=True,
        )
        self.changes: list[Settings] = []
        self.matches: list[Match] = []
        self.parameters = Parameters(self, Settings(), self.changes.append)
        self.diagnostics = Diagnostics(self)
        inputs = Inputs(self, self.parameters.config.input, self.diagnostics)
        matcher = StampMatcher(('color', 'depth'), 20 * MS)
        self.sync = Synchronizer(matcher, self._on_match, self.diagnostics)
        inputs.color(self.sync.input('color', conversions.color_from_msg))
        inputs.depth(self.sync.input('depth', conversions.depth_from_msg))

    def _on_match(self, match: Match) -> None:
        sizes = [value.shape[:2] for _, value in match.values]
        if sizes[0] != sizes[1]:
            raise MessageError(f'sizes {sizes} differ')
        self.matches.append(match)


class Bench:
    """The sample node beside a probe."""

    def __init__(self, domain_id: int, *args: str) -> None:
        self.probe = Probe(domain_id)
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node = Sample(self._context, *args)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        # One thread for both: whenever the probe waits, the node works as well.
        self.probe.node.create_timer(0.002, lambda: self._executor.spin_once(timeout_sec=0.0))

    def close(self) -> None:
        self.probe.close()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def status(self) -> DiagnosticStatus:
        return self.node.diagnostics.status()

    def count(self, name: str) -> int:
        values = {pair.key: pair.value for pair in self.status().values}
        return int(values.get(name, '0'))


@pytest.fixture
def bench(domain_id: int) -> Iterator[Bench]:
    bench = Bench(domain_id)
    yield bench
    bench.close()


def started(domain_id: int, *args: str) -> Settings:
    """The config of a node that is started with parameters."""
    bench = Bench(domain_id, *args)
    try:
        return bench.node.parameters.config
    finally:
        bench.close()


def test_defaults_are_the_configs(domain_id: int) -> None:
    assert started(domain_id) == Settings()


def test_parameters_come_from_the_command_line(domain_id: int) -> None:
    config = started(
        domain_id, '-p', 'number:=5', '-p', 'rule.share:=1', '-p', 'rule.classes:=[cup, book]'
    )
    assert (config.number, config.rule.share, config.rule.classes) == (5, 1.0, ('cup', 'book'))


def test_parameters_come_from_a_file(domain_id: int, tmp_path: Path) -> None:
    path = tmp_path / 'params.yaml'
    path.write_text('sample: {ros__parameters: {rule: {share: 0.25}, mode: slow}}')
    config = started(domain_id, '--params-file', str(path))
    assert (config.rule.share, config.mode) == (0.25, 'slow')


@pytest.mark.parametrize(
    ('value', 'said'),
    [
        ('number:=10', r'number must be in \[1, 9\], got 10'),
        ('number:=many', r'number must be int, got .many.'),
        ('mode:=lazy', 'mode must be one of fast, slow'),
    ],
)
def test_unusable_parameters_are_refused(domain_id: int, value: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        started(domain_id, '-p', value)


def set_parameter(bench: Bench, name: str, value: Any) -> Any:
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return bench.probe.call(SetParameters, 'sample/set_parameters', request).results[0]


def test_a_misspelt_parameter_is_said(domain_id: int, capfd: pytest.CaptureFixture[str]) -> None:
    assert started(domain_id, '-p', 'rule.shared:=0.75') == Settings()
    said = 'no parameter is called "rule.shared", it has no effect; did you mean rule.share?'
    assert said in capfd.readouterr().err


def test_parameters_change_at_run_time(bench: Bench) -> None:
    assert set_parameter(bench, 'rule.share', 0.75).successful
    assert set_parameter(bench, 'rule.classes', ['cup']).successful
    assert bench.node.parameters.config.rule == Rule(0.75, ('cup',))
    assert [change.rule.share for change in bench.node.changes] == [0.75, 0.75]


@pytest.mark.parametrize(
    ('name', 'value', 'said'),
    [
        ('rule.share', 1.5, 'rule.share out of range Min: 0.0, Max: 1.0'),
        ('mode', 'lazy', 'mode must be one of fast, slow'),
        ('number', 4, 'read-only'),
        ('rule.classes', None, 'rule.classes must be list, got None'),  # to be deleted
        ('rule.classes', [1, 2], 'rule.classes must be a list of strings, got [1, 2]'),
    ],
)
def test_unusable_changes_are_refused(bench: Bench, name: str, value: Any, said: str) -> None:
    result = set_parameter(bench, name, value)
    assert not result.successful
    assert said in result.reason
    assert bench.node.parameters.config == Settings()


def test_parameters_describe_themselves(bench: Bench) -> None:
    request = DescribeParameters.Request(names=['rule.share', 'number', 'mode'])
    answer = bench.probe.call(DescribeParameters, 'sample/describe_parameters', request)
    share, number, mode = answer.descriptors
    assert (share.description, share.read_only) == ('a share', False)
    assert share.floating_point_range[0].to_value == 1.0
    assert (number.read_only, number.integer_range[0].to_value) == (True, 9)
    assert mode.additional_constraints == 'one of fast, slow'


def color(stamp_ms: int) -> Image:
    return conversions.color_to_msg(IMAGE, conversions.header_to_msg(stamp_ms * MS, 'camera'))


def depth(stamp_ms: int) -> Image:
    metres = np.ones((4, 6), np.float32)
    return conversions.depth_to_msg(metres, conversions.header_to_msg(stamp_ms * MS, 'camera'))


def test_pairs_are_matched_and_the_rest_counted(bench: Bench) -> None:
    colors = bench.probe.publisher(Image, 'rgb/image')
    depths = bench.probe.publisher(Image, 'depth/image')
    for stamp_ms in (1000, 1033, 1066):
        colors.publish(color(stamp_ms))
    for stamp_ms in (1010, 1076):
        depths.publish(depth(stamp_ms))
    bench.probe.spin_until(lambda: len(bench.node.matches) == 2, 'no two matches')
    assert [match.stamp_ns for match in bench.node.matches] == [1000 * MS, 1066 * MS]
    assert bench.node.matches[0].values[1].header.stamp.nanosec == 10 * MS
    assert (bench.count('color dropped'), bench.count('depth dropped')) == (1, 0)
    assert bench.count('color images received') == 3


def test_a_bad_message_is_refused_and_the_node_lives_on(bench: Bench) -> None:
    colors = bench.probe.publisher(Image, 'rgb/image')
    depths = bench.probe.publisher(Image, 'depth/image')
    bad = color(1000)
    bad.encoding = 'yuv422'
    colors.publish(bad)
    depths.publish(depth(1000))
    bench.probe.spin_until(lambda: bench.count('color images refused') == 1, 'nothing refused')
    colors.publish(color(1033))
    depths.publish(depth(1033))
    bench.probe.spin_until(lambda: len(bench.node.matches) == 1, 'the node is dead')
    assert bench.count('depth images refused') == 0


def test_a_refused_match_takes_no_other_one_with_it(bench: Bench) -> None:
    take_color = bench.node.sync.input('color', conversions.color_from_msg)
    take_depth = bench.node.sync.input('depth', conversions.depth_from_msg)
    small = conversions.color_to_msg(IMAGE[::2], color(1100).header)
    for msg in (depth(1050), depth(1083)):  # the next is due at 1116
        take_depth(msg)
    for msg in (small, color(1116)):
        take_color(msg)
    assert bench.node.matches == []
    take_depth(depth(1117))  # decides on both
    assert [match.stamp_ns for match in bench.node.matches] == [1116 * MS]
    assert bench.count('matched images refused') == 1


def test_compressed_images_by_parameter(domain_id: int) -> None:
    bench = Bench(domain_id, '-p', 'input.compressed:=true')
    colors = bench.probe.publisher(CompressedImage, 'rgb/image/compressed')
    depths = bench.probe.publisher(CompressedImage, 'depth/image/compressedDepth')
    header = conversions.header_to_msg(1000 * MS, 'camera')
    colors.publish(conversions.compressed_color_to_msg(IMAGE, header, quality=90))
    metres = np.ones((4, 6), np.float32)
    depths.publish(conversions.compressed_depth_to_msg(metres, header))
    bench.probe.spin_until(lambda: len(bench.node.matches) == 1, 'no match')
    bench.close()


def test_missing_inputs_are_said(bench: Bench) -> None:
    heard = bench.probe.collect(DiagnosticArray, '/diagnostics')
    complaint = 'on /depth/image: no publisher'
    bench.probe.spin_until(
        lambda: any(complaint in msg.status[0].message for msg in heard), 'nothing is said'
    )
    status = heard[-1].status[0]
    assert (status.level, status.name) == (DiagnosticStatus.WARN, '/sample')
    assert 'no color images yet for' in status.message


def test_a_qos_mismatch_is_said(domain_id: int) -> None:
    bench = Bench(domain_id, '-p', 'input.reliability:=reliable')
    bench.probe.publisher(Image, 'depth/image', qos.input_qos('best_effort', 1), wait=False)
    expected = (
        'on /depth/image: 1 publisher, reliability best_effort, '
        'but the subscription requests reliable'
    )
    bench.probe.spin_until(lambda: expected in bench.status().message, 'nothing is said')
    bench.close()


def test_compressed_images_are_asked_for_reliably_where_that_is_offered(domain_id: int) -> None:
    bench = Bench(domain_id, '-p', 'input.compressed:=true')
    topic = '/depth/image/compressedDepth'

    def asked() -> list[str]:
        found = bench.node.get_subscriptions_info_by_topic(topic)
        return [info.qos_profile.reliability.name for info in found]

    bench.probe.publisher(CompressedImage, topic)
    assert asked() == ['RELIABLE']
    offers_less = qos.input_qos('best_effort', 1)
    weak = bench.probe.publisher(CompressedImage, topic, offers_less, wait=False)
    bench.probe.spin_until(lambda: asked() == ['BEST_EFFORT'], 'the other one stays unheard')
    bench.probe.spin_until(lambda: weak.get_subscription_count() > 0, 'they do not meet')
    weak.publish(CompressedImage())
    bench.probe.spin_until(lambda: bench.count('depth images refused') == 1, 'it is not heard')
    bench.close()


def test_what_gets_lost_is_said_until_it_is_over() -> None:
    watch = InputWatch('depth images', '/depth', 'reliable', since_s=0.0)
    assert not watch.is_losing(0.0)
    watch.record_loss(10.0, 3)
    watch.record_loss(12.0, 4)
    assert watch.loss_message(13.0).startswith(
        'depth images on /depth have been getting lost for 3.0 s: 7'
    )
    assert watch.is_losing(16.9)
    assert not watch.is_losing(17.0)
    watch.record_loss(20.0, 1)
    assert ' for 1.0 s: 1 so far' in watch.loss_message(21.0)
    assert watch.num_lost == 8


def test_a_missing_clock_is_said(domain_id: int) -> None:
    bench = Bench(domain_id, '-p', 'use_sim_time:=true')
    assert 'no message was received on /clock' in bench.status().message
    bench.close()


def test_negative_clock_times_are_ignored(
    domain_id: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(TimeSource, 'clock_callback', TimeSource.clock_callback)
    ignore_negative_clock_times()
    probe = Probe(domain_id)
    probe.node.set_parameters([Parameter('use_sim_time', value=True)])
    clock = probe.publisher(Clock, topics.CLOCK)
    for sec in (-1, -1, 5):
        message = Clock()
        message.clock.sec = sec
        clock.publish(message)
        probe.spin_for(0.1)
    probe.spin_until(lambda: probe.node.get_clock().now().nanoseconds == 5 * 10**9, 'no 5 s')
    probe.close()
    assert [r.message for r in caplog.records if 'clock' in r.message] == [
        '/clock: negative time of -1 s ignored; check its publisher'
    ]


def test_problems_stand_until_they_are_taken_back(bench: Bench) -> None:
    bench.node.diagnostics.set_problem('map', 'the map is full', severe=True)
    assert bench.status().level == DiagnosticStatus.ERROR
    assert bench.status().message == 'the map is full'
    bench.node.diagnostics.clear_problem('map')
    assert bench.status().level == DiagnosticStatus.OK


def test_core_logging_reaches_the_nodes_logger(
    bench: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    bridge_logging(bench.node)
    logging.getLogger('some.core').warning('the lens is %s', 'dirty')
    logging.getLogger('some.core').debug('not this')
    said = capfd.readouterr().err
    assert '[WARN]' in said
    assert '[sample]: the lens is dirty' in said
    assert 'not this' not in said


@pytest.mark.parametrize(
    'data',
    [b'', b'\x00\x01\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 60, b'\xff' * 20],
)
def test_bytes_that_are_no_message_are_counted_and_their_topic_named(
    bench: Bench, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    publisher = bench.probe.publisher(Image, 'rgb/image')
    for _ in range(5):
        publisher.publish(data)
    bench.probe.spin_until(lambda: bench.count('color images refused') == 5, 'not counted')
    bench.probe.publisher(Image, 'depth/image')
    said = [line for line in capfd.readouterr().err.splitlines() if 'no sensor_msgs/Image' in line]
    assert len(said) == 1  # in a while
    assert f'/rgb/image: {len(data)} bytes are no sensor_msgs/Image' in said[0]


def test_a_message_larger_than_any_is_not_taken_apart(
    bench: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    listener = StaticFrameListener(bench.node, bench.node.diagnostics)
    publisher = bench.probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    publisher.publish(b'\x00\x01\x00\x00' + bytes(2_000_000))
    bench.probe.spin_until(lambda: bench.count('static transforms refused') == 1, 'not counted')
    assert '/tf_static: message of 2000004 bytes exceeds 2000000 bytes' in capfd.readouterr().err
    assert listener.frames.find('base', 'camera') is None


def test_static_transforms_that_are_none_are_counted_too(
    bench: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    listener = StaticFrameListener(bench.node, bench.node.diagnostics)
    publisher = bench.probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    for data in (b'\x00\x01\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 60, b'\xff'):
        publisher.publish(data)
    edge = conversions.transform_to_msg(np.eye(4), 0, 'base', 'camera')
    publisher.publish(TFMessage(transforms=[edge]))
    bench.probe.spin_until(lambda: listener.frames.find('base', 'camera') is not None, 'unheard')
    assert bench.count('static transforms refused') == 3
    said = [line for line in capfd.readouterr().err.splitlines() if 'TFMessage' in line]
    assert len(said) == 1
    assert '/tf_static: 4 bytes are no tf2_msgs/TFMessage' in said[0]


def test_children_of_odom_whose_names_never_end_are_refused(
    bench: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    static = StaticFrames()
    wheels = WheelOdometry(bench.node, 'odom', static, bench.node.diagnostics)
    publisher = bench.probe.publisher(TFMessage, '/tf', qos.TF)
    for n in range(20):
        edge = conversions.transform_to_msg(np.eye(4), MS, 'odom', f'base_{n}')
        publisher.publish(TFMessage(transforms=[edge]))
    bench.probe.spin_until(lambda: bench.count('transforms refused') == 4, 'not counted')
    assert wheels.at(MS, 'base_15') is not None
    assert wheels.at(MS, 'base_16') is None
    said = [line for line in capfd.readouterr().err.splitlines() if 'children of odom' in line]
    assert len(said) == 1
    assert 'children of odom: frame "base_16" exceeds the limit of 16 frames;' in said[0]
