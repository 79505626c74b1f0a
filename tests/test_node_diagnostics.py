"""Diagnostics, clock and logging of a node."""

import logging
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from hoid_common import topics
from hoid_common.inputs.input_watch import InputWatch
from hoid_common.ros import conversions
from hoid_common.ros.lifecycle import bridge_logging
from hoid_common.ros.run import ignore_negative_clock_times
from hoid_system_tests.detector_bench import write_model
from hoid_system_tests.filter_peer import DEPTH_M, IMAGE
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.sample_bench import SampleBench


def test_lost_messages_are_reported_until_the_loss_ends() -> None:
    watch = InputWatch('depth images', '/depth', 'reliable', since_s=0.0)
    assert not watch.is_losing(0.0)
    watch.record_loss(10.0, 3)
    watch.record_loss(12.0, 4)
    watch.record_message(12.5)
    assert watch.loss_message(13.0) == (
        '1 of 8 depth images on /depth have arrived in 3.0 s: check the network and the processor '
        'load'
    )
    assert watch.is_losing(16.9)
    assert not watch.is_losing(17.0)
    watch.record_loss(20.0, 1)
    assert not watch.is_losing(20.5)  # a single message
    watch.record_loss(21.0, 1)
    assert watch.is_losing(21.0)
    assert watch.loss_message(22.0).startswith('0 of 2 depth images on /depth have arrived in 2.0')
    assert watch.num_lost == 9


def test_what_lost_messages_mean_depends_on_who_sends_them() -> None:
    for reliability, is_own, remedy in (
        ('best_effort', False, 'start their publisher with FASTRTPS_DEFAULT_PROFILES_FILE=/p or '),
        ('reliable', False, 'check the network and the processor load'),
        ('best_effort', True, 'reduce the load of the computer'),
    ):
        watch = InputWatch('features', '/features', reliability, since_s=0.0)
        watch.record_loss(1.0, 1)
        assert f' s: {remedy}' in watch.loss_message(3.0, '/p', is_own=is_own)


def test_a_missing_clock_is_reported(domain_id: int) -> None:
    sample = SampleBench(domain_id, '-p', 'use_sim_time:=true')
    assert 'no message was received on /clock' in sample.status().message
    sample.close()


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


def test_problems_are_reported_until_they_are_cleared(sample: SampleBench) -> None:
    sample.node.diagnostics.set_problem('map', 'the map is full', severe=True)
    assert sample.status().level == DiagnosticStatus.ERROR
    assert sample.status().message == 'the map is full'
    sample.node.diagnostics.clear_problem('map')
    assert sample.status().level == DiagnosticStatus.OK


def test_core_log_records_reach_the_logger_of_the_node(
    sample: SampleBench, capfd: pytest.CaptureFixture[str]
) -> None:
    bridge_logging(sample.node)
    logging.getLogger('some.core').warning('the lens is %s', 'dirty')
    logging.getLogger('some.core').debug('not this')
    output = capfd.readouterr().err
    assert '[WARN]' in output
    assert '[sample]: the lens is dirty' in output
    assert 'not this' not in output


@pytest.mark.thorough
def test_a_missing_camera_is_logged_in_one_line_by_all_nodes_together(
    start: Start, probe: Probe, tmp_path: Path
) -> None:
    model = str(write_model(tmp_path / 'model.onnx'))
    for node, params in (
        ('hoid_detector', {'model': model}),
        ('hoid_filter', {}),
        ('rgbd_slam', {}),
    ):
        start(node, f'{node}_node', params)

    def lines(text: str) -> list[str]:
        logs = [path.read_text() for path in sorted(tmp_path.glob('log_*/*'))]
        told = (line for log in logs for line in log.splitlines() if 'active, waiting' not in line)
        return [line for line in told if text in line]

    probe.spin_until(lambda: bool(lines('no color images yet')), 'nothing is logged', 60.0)
    probe.spin_for(3.0)
    (line,) = lines('no publisher')
    assert '[hoid_filter]' in line
    for topic in ('/rgb/image', '/depth/image', '/rgb/camera_info'):
        assert f' on {topic}: no publisher' in line
    assert lines('features') == lines('detections') == []
    colors, depths = (probe.publisher(Image, topic) for topic in ('rgb/image', 'depth/image'))
    for i in range(60):
        header = conversions.header_to_msg(1_000_000_000 + i * 50_000_000, 'camera')
        colors.publish(conversions.color_to_msg(IMAGE, header))
        depths.publish(conversions.depth_to_msg(np.asarray(DEPTH_M), header))
        probe.spin_for(0.05)
    received = lines('receiving')
    assert 1 <= len(received) <= 2  # two if the depth images begin in another second
    for text in ('[hoid_filter]: receiving ', 'color images on /rgb/image', 'on /depth/image'):
        assert any(text in line for line in received)
