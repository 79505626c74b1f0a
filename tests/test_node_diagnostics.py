"""Diagnostics, clock and logging of a node."""

import logging

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock

from hoid_common import topics
from hoid_common.inputs.input_watch import InputWatch
from hoid_common.ros.clocks import ignore_negative_clock_times
from hoid_common.ros.logs import bridge_logging
from hoid_system_tests.probe import Probe
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
    assert watch.loss_message(21.0).startswith('0 of 1 depth images on /depth have arrived in 1.0')
    assert watch.num_lost == 8


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
