"""Programs of the two hosts: a simulated camera, and the nodes with a listener.

Each appends lines to a file: the camera the stamps of its images, the listener the stamps of
odometry and the problems reported by diagnostics, with the time of arrival.
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
_NOISE_M = 0.005  # as in real depth, which therefore compresses as badly


def camera(write_line: Callable[[str], None]) -> None:
    """Publish compressed images until interrupted."""
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
        write_line(f'{SENT} {stamp_ns}')
        due_s += 1 / RATE_HZ
        time.sleep(max(0.0, due_s - time.monotonic()))


def robot(write_line: Callable[[str], None], folder: Path) -> None:
    """Run filter and SLAM, and record odometry and diagnostics, until interrupted."""
    listening = {'input.compressed': True}
    parameters: dict[str, dict[str, Any]] = {
        FILTER: {'strategy': 'none', **listening},
        SLAM: {'map_directory': str(folder), **listening},
    }
    specs = node_specs(NodeOptions((FILTER, SLAM), parameters=parameters))
    with Supervisor(specs, log_dir=folder):
        node = rclpy.create_node('listener')
        _listen(node, write_line)
        executor = SteadyExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once()


def _listen(node: Node, write_line: Callable[[str], None]) -> None:
    def on_odometry(msg: Odometry) -> None:
        write_line(f'{ODOMETRY} {conversions.stamp_from_msg(msg.header.stamp)} {time.time_ns()}')

    def on_diagnostics(msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.level != DiagnosticStatus.OK:
                write_line(f'{COMPLAINT} {time.time_ns()} {status.name}: {status.message}')

    node.create_subscription(Odometry, topics.ODOM, on_odometry, qos.OUTPUT)
    node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, on_diagnostics, qos.OUTPUT)


def main(role: str, folder: Path) -> None:
    """Run one host's program until interrupted; its events are appended to FOLDER/ROLE."""
    interrupt_on_termination()
    rclpy.init()
    with (folder / role).open('a', encoding='utf-8', buffering=1) as file:

        def write_line(line: str) -> None:
            file.write(f'{line}\n')

        with suppress(KeyboardInterrupt):
            if role == camera.__name__:
                camera(write_line)
            else:
                robot(write_line, folder)
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(sys.argv[1], Path(sys.argv[2]))
