"""The commands `nodes` and `play` where a restart is refused, or nobody reads their output."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rclpy
from sensor_msgs.msg import CameraInfo

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.storage import bag_types
from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.node_harness import (
    START_S,
    NodeHarness,
    Setup,
    camera,
    odometry_result,
    running_nodes,
)
from hoid_benchmarks.faults.live.sender import CAMERA, OWN_DETECTIONS
from hoid_benchmarks.faults.live.services import ANSWER_S, Services
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SLAM
from hoid_bringup.live.ros_domain import own_domain
from hoid_common import topics
from hoid_common.ros import qos
from hoid_detector.model.model_path import SYNTHETIC, find_model

REFUSED, UNREAD, SMALL = 'a refused restart', 'output that nobody reads', 'play of few bytes'
_HOID = (sys.executable, '-m', 'hoid_bringup')
_WHILE_S = 5.0
# From the repair of a file to the next try, which follows a pause of 4 s at most, and its start.
_BACK_S = 15.0
_LEAST_SHARE = 0.9  # of images with odometry
_END_S = 20.0
_FIRST_S = 15.0  # from the start of the program to its first message
_NUM_MESSAGES, _PERIOD_NS, _START_NS = 5, 100_000_000, 1_305_031_102_000_000_000


def command_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcome of each of the three for each seed."""
    model = folder / 'model.onnx'
    folder.mkdir(parents=True)
    good = find_model(SYNTHETIC).read_bytes()
    model.write_bytes(good)
    setup = Setup((DETECTOR, FILTER, SLAM), restart=True, model=str(model))
    with running_nodes(folder / 'nodes', setup) as harness:
        for seed in seeds:
            start_s = time.monotonic()
            complaint = _refused_restart(harness, model, good[: 1000 * (seed + 1)])
            model.write_bytes(good)
            complaint = complaint or _detector_back(harness)
            yield Outcome(REFUSED, seed, complaint, wall_s=time.monotonic() - start_s)
    for seed in seeds:
        for kind, check in ((UNREAD, _unread_output), (SMALL, _small_messages)):
            start_s = time.monotonic()
            complaint = check(folder / f'{kind} {seed}')
            yield Outcome(kind, seed, complaint, wall_s=time.monotonic() - start_s)


def _refused_restart(harness: NodeHarness, model: Path, bad: bytes) -> str:
    """Damage the model of a detector that is killed; the other nodes must not notice."""
    harness.nodes.poll()
    others = {name: pid for name, pid in harness.nodes.pids.items() if name != DETECTOR}
    model.write_bytes(bad)
    os.kill(harness.nodes.pids[DETECTOR], signal.SIGKILL)
    share = harness.sender.send_for(_WHILE_S)
    exits = harness.nodes.poll()
    if not any(ended.refused_to_start for ended in exits):
        return f'no refusal: {"; ".join(map(str, exits))}'
    if {name: pid for name, pid in harness.nodes.pids.items() if name != DETECTOR} != others:
        return 'another node was restarted'
    return odometry_result(share, _LEAST_SHARE).complaint


def _detector_back(harness: NodeHarness) -> str:
    missing = harness.sender.missing_outputs(_BACK_S, (OWN_DETECTIONS,))
    return f'the detector is not back in {_BACK_S:g} s' if missing else ''


def _unread_output(folder: Path) -> str:
    """Run the nodes with a full pipe for their output: images and services must not wait."""
    setup = Setup((FILTER, SLAM))
    argv = ['nodes', '--no-detector', '--filter', 'none', '--no-scene']
    argv += ['--set', f'map_directory={folder}']
    with own_domain(), _unread(argv) as process, camera(setup) as sender:
        if sender.missing_outputs(START_S, (topics.ODOM,)):
            return f'no odometry within {START_S:g} s'
        share = sender.send_for(_WHILE_S)
        unanswered = Services(sender, (SLAM,)).unanswered(ANSWER_S)
        if process.poll() is not None:
            return f'the nodes ended with status {process.returncode}'
    if unanswered:
        return f'no response from {", ".join(unanswered)}'
    return odometry_result(share, _LEAST_SHARE).complaint


@contextmanager
def full_pipe() -> Iterator[int]:
    """Yield the writing end of a pipe that is full and that nobody reads."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    try:
        while True:
            os.write(writer, bytes(4096))
    except BlockingIOError:
        os.set_blocking(writer, True)
    try:
        yield writer
    finally:
        os.close(writer)
        os.close(reader)


@contextmanager
def _unread(argv: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command whose output is a full pipe."""
    with full_pipe() as writer:
        process = subprocess.Popen([*_HOID, *argv], stdout=writer, stderr=writer, process_group=0)
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _small_messages(bag: Path) -> str:
    """Play a topic of a few hundred bytes a second again and again."""
    with BagWriter(bag) as writer:
        writer.add_topic('/info', bag_types.CAMERA_INFO)
        for i in range(_NUM_MESSAGES):
            stamp_ns = _START_NS + i * _PERIOD_NS
            writer.write('/info', stamp_ns, bag_messages.camera_info(stamp_ns, CAMERA))
    with own_domain(), camera(Setup()) as sender, _unread(['play', str(bag), '--loop']) as process:
        received: list[CameraInfo] = []
        sender.node.create_subscription(CameraInfo, 'info', received.append, qos.OUTPUT)
        end_s = time.monotonic() + _FIRST_S
        while len(received) <= _NUM_MESSAGES and time.monotonic() < end_s and rclpy.ok():
            sender.spin_until(time.monotonic() + 0.1)
        if process.poll() is not None:
            return f'play ended with status {process.returncode}'
    is_repeated = len(received) > _NUM_MESSAGES
    return '' if is_repeated else f'{len(received)} messages in {_FIRST_S:g} s'
