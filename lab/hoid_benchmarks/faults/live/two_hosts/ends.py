"""What runs on each of two hosts: a camera, or the nodes and who listens to them.

Each appends lines to a file: the camera the stamps that it sends, the listener the stamps of
odometry and what diagnostics complain of, with the time.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage

from hoid_benchmarks.faults.live.sender import CAMERA, FRAME, Scene
from hoid_bringup.live.node_specs import FILTER, SLAM, NodeOptions, node_specs
from hoid_bringup.live.supervisor import Supervisor
from hoid_common import topics
from hoid_common.process.signals import interrupt_on_termination
from hoid_common.ros import conversions, qos
from hoid_common.ros.execution.executor import SteadyExecutor

SENT, ODOMETRY, COMPLAINT = 'sent', 'odometry', 'complaint'
RATE_HZ = 10.0
_QUALITY = 90
_NOISE_M = 0.005  # which real depth has, and which makes it as large


def camera(say: Callable[[str], None]) -> None:
    """Send compressed images until interrupted."""
    node = rclpy.create_node('camera')
    color = topics.compressed(topics.RGB_IMAGE)
    depth = topics.compressed_depth(topics.DEPTH_IMAGE)
    colors = node.create_publisher(CompressedImage, color, qos.OUTPUT)
    depths = node.create_publisher(CompressedImage, depth, qos.OUTPUT)
    infos = node.create_publisher(CameraInfo, topics.CAMERA_INFO, qos.OUTPUT)
    image_bgr, depth_m, _ = Scene().view(0)
    noise_m = np.random.default_rng(0).normal(0.0, _NOISE_M, depth_m.shape)
    depth_m = np.round(depth_m + noise_m, 3).astype(np.float32)
    due_s = time.monotonic()
    while True:
        stamp_ns = time.time_ns()
        header = conversions.header_to_msg(stamp_ns, FRAME)
        infos.publish(conversions.camera_to_msg(CAMERA, header))
        depths.publish(conversions.compressed_depth_to_msg(depth_m, header))
        colors.publish(conversions.compressed_color_to_msg(image_bgr, header, _QUALITY))
        say(f'{SENT} {stamp_ns}')
        due_s += 1 / RATE_HZ
        time.sleep(max(0.0, due_s - time.monotonic()))


def robot(say: Callable[[str], None], folder: Path) -> None:
    """Run filter and SLAM, and listen to them, until interrupted."""
    listening = {'input.compressed': True}
    parameters: dict[str, dict[str, Any]] = {
        FILTER: {'strategy': 'none', **listening},
        SLAM: {'dense.enabled': False, 'objects.enabled': False, **listening},
    }
    specs = node_specs(NodeOptions((FILTER, SLAM), parameters=parameters), folder)
    with Supervisor(specs, log_dir=folder):
        node = rclpy.create_node('listener')
        _listen(node, say)
        executor = SteadyExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once()


def _listen(node: Node, say: Callable[[str], None]) -> None:
    def on_odometry(msg: Odometry) -> None:
        say(f'{ODOMETRY} {conversions.stamp_from_msg(msg.header.stamp)} {time.time_ns()}')

    def on_diagnostics(msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.level != DiagnosticStatus.OK:
                say(f'{COMPLAINT} {time.time_ns()} {status.name}: {status.message}')

    node.create_subscription(Odometry, topics.ODOM, on_odometry, qos.OUTPUT)
    node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, on_diagnostics, qos.OUTPUT)


def main(role: str, folder: Path) -> None:
    """Play a role until interrupted, and write what happens into a folder."""
    interrupt_on_termination()
    rclpy.init()
    with (folder / role).open('a', encoding='utf-8', buffering=1) as file:

        def say(line: str) -> None:
            file.write(f'{line}\n')

        with suppress(KeyboardInterrupt):
            if role == camera.__name__:
                camera(say)
            else:
                robot(say, folder)
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(sys.argv[1], Path(sys.argv[2]))
