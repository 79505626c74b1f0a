"""`hoid play` and `hoid record` on real topics."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.info import summarize
from hoid_bags.bag.stamps import header_stamp_ns
from hoid_bags.storage import bag_types
from hoid_common.ros import qos
from hoid_common.ros.conversions import (
    camera_from_msg,
    color_from_msg,
    depth_from_msg,
    stamp_from_msg,
)
from hoid_common.values import NS_PER_S, CameraModel
from hoid_system_tests.probe import Probe

CAMERA = CameraModel(160, 120, 130.0, 131.0, 79.5, 59.5)
NUM_FRAMES = 30
START_NS = 1_305_031_102_175_304_123
PERIOD_NS = 33_333_333
LIMIT_S = 60


def stamps_ns() -> list[int]:
    return [START_NS + i * PERIOD_NS for i in range(NUM_FRAMES)]


def color(i: int) -> Any:
    return np.full((120, 160, 3), (i, 2 * i, 255 - i), np.uint8)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / 'a bag'
    with BagWriter(path) as writer:
        writer.add_topic('rgb/camera_info', bag_types.CAMERA_INFO)
        writer.add_topic('rgb/image', bag_types.IMAGE)
        writer.add_topic('depth/image', bag_types.IMAGE)
        for i, stamp_ns in enumerate(stamps_ns()):
            depth_mm = np.full((120, 160), 500 + i, np.uint16)
            writer.write('rgb/camera_info', stamp_ns, bag_messages.camera_info(stamp_ns, CAMERA))
            writer.write('depth/image', stamp_ns, bag_messages.image(stamp_ns, depth_mm, '16UC1'))
            writer.write('rgb/image', stamp_ns, bag_messages.image(stamp_ns, color(i), 'bgr8'))
    return path


class Commands:
    """`hoid` commands in the background, which `close` ends."""

    def __init__(self, domain_id: int) -> None:
        self._env = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        self._running: list[subprocess.Popen[str]] = []

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        argv = [sys.executable, '-m', 'hoid_bringup', *map(str, arguments)]
        process = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True, env=self._env)
        self._running.append(process)
        return process

    def close(self) -> None:
        for process in self._running:
            process.kill()
            process.wait()
            if process.stderr is not None:
                process.stderr.close()


@pytest.fixture
def commands(domain_id: int) -> Iterator[Commands]:
    running = Commands(domain_id)
    yield running
    running.close()


def ended(probe: Probe, process: subprocess.Popen[str]) -> tuple[int, str]:
    """Receive messages until a command ends; return its status and error output."""
    probe.spin_until(lambda: process.poll() is not None, 'the command does not end', LIMIT_S)
    probe.spin_for(0.2)
    assert process.stderr is not None
    return process.returncode, process.stderr.read()


def test_the_played_messages_equal_those_in_the_bag(
    probe: Probe, commands: Commands, bag: Path
) -> None:
    images = probe.collect(Image, 'r1/rgb/image', qos.input_qos('best_effort', 50), wait=False)
    depths = probe.collect(Image, 'r1/depth/image', wait=False)
    infos = probe.collect(CameraInfo, 'r1/rgb/camera_info', wait=False)
    clocks = probe.collect(Clock, '/clock', qos.CLOCK, wait=False)
    process = commands.start(
        'play', bag, '--namespace', 'r1', '--require', 'rgb/image=1', '--require', 'depth/image=1'
    )
    assert ended(probe, process) == (0, '')
    for messages in (images, depths, infos):
        assert [stamp_from_msg(m.header.stamp) for m in messages] == stamps_ns()
        assert {m.header.frame_id for m in messages} == {bag_messages.CAMERA_FRAME}
    for i in range(NUM_FRAMES):
        np.testing.assert_array_equal(color_from_msg(images[i]), color(i))
        assert (depth_from_msg(depths[i]) == np.float32((500 + i) / 1000)).all()
    assert camera_from_msg(infos[0]) == CAMERA
    times_ns = [stamp_from_msg(m.clock) for m in clocks]
    assert len(times_ns) > 10
    assert times_ns == sorted(times_ns)
    assert START_NS <= times_ns[0] < times_ns[-1] <= stamps_ns()[-1] + NS_PER_S


@pytest.mark.parametrize(
    ('topic', 'kind'),
    [('rgb/image', Image), ('rgb/camera_info', CameraInfo)],
    ids=['image', 'info'],
)
def test_stamps_increase_when_a_bag_loops(
    topic: str, kind: type[Any], probe: Probe, commands: Commands, bag: Path
) -> None:
    """Camera infos have few bytes, so that the buffer of a replay never fills by size."""
    images = probe.collect(kind, topic, wait=False)
    process = commands.start('play', bag, '--loop', '--rate', '2', '--topics', topic)
    probe.spin_until(lambda: len(images) > 2.5 * NUM_FRAMES, 'the bag is not repeated')
    process.send_signal(signal.SIGINT)
    status, errors = ended(probe, process)
    assert (status, errors) == (130, 'hoid play: interrupted\n')
    seen_ns = [stamp_from_msg(m.header.stamp) for m in images]
    assert seen_ns == sorted(seen_ns)
    assert np.diff(seen_ns).max() == 100_000_000


def test_lockstep_waits_for_odometry(probe: Probe, commands: Commands, bag: Path) -> None:
    answers = probe.publisher(Odometry, 'odom', wait=False)
    images = probe.collect(Image, 'rgb/image', wait=False)
    process = commands.start('play', bag, '--lockstep', '--rate', '100', '--no-clock')
    for i in range(NUM_FRAMES):
        probe.spin_until_count(images, i + 1, f'image {i} does not come')
        if i < 3:
            probe.spin_for(0.2)
        assert len(images) == i + 1
        answers.publish(Odometry(header=images[i].header))
    assert ended(probe, process) == (0, '')


def test_a_truncated_bag_is_played_and_reported(
    probe: Probe, commands: Commands, bag: Path
) -> None:
    file = next(bag.glob('*.mcap'))
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])
    images = probe.collect(Image, 'rgb/image', wait=False)
    status, errors = ended(probe, commands.start('play', bag, '--require', 'rgb/image=1'))
    assert status == 1
    assert errors.startswith(f'hoid play: {bag}: cut off after ')
    assert errors.count('\n') == 1
    assert [stamp_from_msg(m.header.stamp) for m in images] == stamps_ns()[: len(images)]
    assert 5 < len(images) < NUM_FRAMES


def test_missing_subscribers_and_bags_are_reported(
    probe: Probe, commands: Commands, bag: Path
) -> None:
    status, errors = ended(
        probe, commands.start('play', bag, '--require', 'rgb/image=2', '--wait', '1')
    )
    assert status == 1
    assert errors == (
        'hoid play: topic "rgb/image": 0 of 2 subscribers after 1 s; are the nodes running?\n'
    )
    status, errors = ended(probe, commands.start('play', bag.parent / 'none'))
    assert status == 1
    assert errors.endswith('none: no such bag\n')


def test_the_recorded_messages_equal_those_published(
    probe: Probe, commands: Commands, bag: Path, tmp_path: Path
) -> None:
    recorded = tmp_path / 'recorded'
    recorder = commands.start('record', recorded, '--topics', 'rgb/image', '--use-sim-time')
    player = commands.start('play', bag, '--require', 'rgb/image=1', '--wait', '20')
    assert ended(probe, player) == (0, '')
    recorder.send_signal(signal.SIGINT)
    assert ended(probe, recorder) == (0, '')
    summary = summarize(recorded)
    assert [t.name for t in summary.topics] == ['/rgb/image']
    assert START_NS <= summary.start_ns < summary.end_ns <= stamps_ns()[-1] + NS_PER_S
    with BagReader(recorded) as reader:
        seen_ns = [header_stamp_ns(message.data) for message in reader.messages()]
    assert seen_ns == stamps_ns()[-len(seen_ns) :]
    assert len(seen_ns) > NUM_FRAMES - 3  # recording starts when /clock arrives


@pytest.mark.parametrize('name', ['SIGHUP', 'SIGQUIT', 'SIGTERM'])
def test_any_signal_that_ends_a_recording_leaves_a_complete_bag(
    name: str, probe: Probe, commands: Commands, tmp_path: Path
) -> None:
    recorder = commands.start('record', tmp_path / 'bag', '--topics', 'clock')
    publisher = probe.publisher(Clock, 'clock')
    publisher.publish(Clock())
    probe.spin_for(0.3)
    for _ in range(3):  # a closing shell sends the signal more than once
        recorder.send_signal(signal.Signals[name])
    assert ended(probe, recorder) == (0, '')
    assert summarize(tmp_path / 'bag').num_messages == 1
    assert [path.name for path in tmp_path.iterdir()] == ['bag']


@pytest.mark.thorough
def test_a_killed_recording_loses_at_most_one_second(
    probe: Probe, commands: Commands, tmp_path: Path
) -> None:
    recorder = commands.start('record', tmp_path / 'bag', '--topics', 'clock')
    publisher = probe.publisher(Clock, 'clock')
    sent_ns = []
    for _ in range(60):
        sent_ns.append(time.time_ns())
        publisher.publish(Clock())
        probe.spin_for(0.05)
    recorder.kill()
    killed_ns = time.time_ns()
    ended(probe, recorder)
    (left,) = tmp_path.iterdir()
    status, errors = ended(probe, commands.start('info', tmp_path / 'other'))
    assert status == 1
    assert errors.startswith(f'hoid: {left}: left by a killed recording; "hoid info --repair"')
    assert ended(probe, commands.start('info', '--repair', left)) == (0, '')
    with BagReader(tmp_path / 'bag') as reader:
        seen_ns = [message.log_ns for message in reader.messages()]
    assert len(seen_ns) >= sum(stamp_ns < killed_ns - NS_PER_S for stamp_ns in sent_ns)
    assert seen_ns[-1] > killed_ns - NS_PER_S


def test_a_recording_without_messages_leaves_no_bag(
    probe: Probe, commands: Commands, tmp_path: Path
) -> None:
    process = commands.start('record', tmp_path / 'bag', '--topics', 'silence')
    probe.publisher(Image, 'silence')  # returns once the recorder subscribes
    process.send_signal(signal.SIGINT)
    status, errors = ended(probe, process)
    assert status == 1
    assert errors == (
        f'hoid record: {tmp_path / "bag"}: nothing was recorded on silence; are these topics '
        'published?\n'
    )
    assert list(tmp_path.iterdir()) == []
