"""Two robots, each with its own suite, camera and frame tree, on one network."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hoid_msgs.msg import SlamStatus
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from hoid_bringup.live.supervisor import ProcessSpec, Supervisor
from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.values import FloatArray
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.probe import Probe
from hoid_system_tests.sliding_camera import CAMERA, PERIOD_NS, STEP_M, image_topics, write_sliding

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

FRAMES = 30
LIMIT_S = 120.0
PARAMETERS = """/**:
  ros__parameters:
    input: {reliability: reliable, queue_length: 100}
"""


class Robot(NamedTuple):
    name: str
    start_ns: int
    slides_px: tuple[int, int]
    moves_m: tuple[float, float, float]  # x forward, y left, z up
    compressed: bool


ROBOTS = (
    Robot('a', 1_000_000_000_000_000_000, (1, 0), (0, -1, 0), compressed=False),
    Robot('b', 1_400_000_000_000_000_000, (0, 1), (0, 0, -1), compressed=True),
)


class Outputs:
    """The outputs of one robot."""

    def __init__(self, probe: Probe, robot: Robot) -> None:
        ns = f'/{robot.name}'
        self.odom = probe.collect(Odometry, f'{ns}/odom', wait=False)
        self.status = probe.collect(SlamStatus, f'{ns}/slam_status', wait=False)
        self.tf = probe.collect(TFMessage, f'{ns}/tf', qos.TF, wait=False)
        camera = probe.publisher(CameraInfo, f'{ns}/rgb/camera_info', wait=False)
        probe.spin_until(
            lambda: camera.get_subscription_count() == 2,  # filter and SLAM
            f'{ns} does not subscribe',
            LIMIT_S,
        )
        probe.spin_for(0.5)  # until the subscribers have discovered the publisher
        header = conversions.header_to_msg(robot.start_ns - 1, OPTICAL)
        camera.publish(conversions.camera_to_msg(CAMERA, header))
        probe.spin_until(lambda: bool(self.status), f'{ns} does not get ready', LIMIT_S)
        self._probe = probe

    def await_edges(self, expected: set[tuple[str, str, int]]) -> None:
        """Wait until these are all edges of its frame tree: parent, child, stamp [ns]."""
        self._probe.spin_until(lambda: edges(self.tf) == expected, 'transforms differ')


@pytest.fixture
def suites(domain_id: int, tmp_path: Path) -> Iterator[Supervisor]:
    """`hoid nodes` for both robots."""
    params = tmp_path / 'params.yaml'
    params.write_text(PARAMETERS)
    argv = ('nodes', '--no-detector', '--filter', 'none', '--no-scene', '--params', str(params))
    specs = []
    for robot in ROBOTS:
        own = ('--namespace', robot.name, *(('--compressed',) if robot.compressed else ()))
        specs.append(ProcessSpec(robot.name, (sys.executable, '-m', 'hoid_bringup', *argv, *own)))
    assert os.environ['ROS_DOMAIN_ID'] == str(domain_id)
    with Supervisor(specs, log_dir=tmp_path) as running:
        yield running


def record(folder: Path, robot: Robot) -> Path:
    """Write a robot's recording."""
    bag = folder / f'bag_{robot.name}'
    write_sliding(bag, robot.start_ns, FRAMES, robot.slides_px, compressed=robot.compressed)
    return bag


def play(bag: Path, robot: Robot) -> subprocess.Popen[str]:
    """Play a robot's recording in its namespace, image by image."""
    color, depth, _ = image_topics(robot.compressed)
    listeners = {topics.CAMERA_INFO: 2, color: 1, depth: 1}
    required = [f'--require={name}={number}' for name, number in listeners.items()]
    argv = ['play', str(bag), '--namespace', robot.name, '--no-clock', '--lockstep', *required]
    return subprocess.Popen(
        [sys.executable, '-m', 'hoid_bringup', *argv], stderr=subprocess.PIPE, text=True
    )


def positions_m(odom: list[Any]) -> FloatArray:
    return np.array([conversions.pose_from_msg(m.pose.pose)[:3, 3] for m in odom])


def edges(tf: list[Any]) -> set[tuple[str, str, int]]:
    return {
        (e.header.frame_id, e.child_frame_id, conversions.stamp_from_msg(e.header.stamp))
        for msg in tf
        for e in msg.transforms
    }


def test_each_robot_follows_its_own_camera(
    suites: Supervisor, probe: Probe, tmp_path: Path
) -> None:
    bags = {robot: record(tmp_path, robot) for robot in ROBOTS}
    diagnostics = probe.collect(DiagnosticArray, '/diagnostics', wait=False)
    outputs = {robot: Outputs(probe, robot) for robot in ROBOTS}
    players = [play(bag, robot) for robot, bag in bags.items()]
    probe.spin_until(
        lambda: all(p.poll() is not None for p in players), 'a player does not end', LIMIT_S
    )
    for player in players:
        assert player.stderr is not None
        assert (player.returncode, player.stderr.read()) == (0, '')
    probe.spin_until(
        lambda: all(len(h.odom) == FRAMES for h in outputs.values()), 'odometry is missing'
    )
    for robot, received in outputs.items():
        stamps_ns = [robot.start_ns + i * PERIOD_NS for i in range(FRAMES)]
        assert [conversions.stamp_from_msg(m.header.stamp) for m in received.odom] == stamps_ns
        true_m = STEP_M * np.arange(FRAMES)[:, None] * np.array(robot.moves_m)
        np.testing.assert_allclose(positions_m(received.odom), true_m, atol=0.02)
        received.await_edges(
            {edge for t in stamps_ns for edge in (('map', 'odom', t), ('odom', OPTICAL, t))}
        )
    assert probe.node.count_publishers('/tf') == 0
    names = {status.name for msg in diagnostics for status in msg.status}
    assert {f'/{r.name}/{node}' for r in ROBOTS for node in ('hoid_filter', 'rgbd_slam')} <= names
    assert not suites.poll()
