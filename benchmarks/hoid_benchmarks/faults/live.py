"""The filter and the SLAM node, sent wrong messages among good ones."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import rclpy
from hoid_msgs.msg import Detection, DetectionArray, Features, FeatureVerdicts, SlamStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.damage import Rng
from hoid_benchmarks.faults.messages import mutated
from hoid_bringup.live.node_specs import FILTER, SLAM, NodeOptions, node_specs
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import Supervisor
from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.values import CameraModel

CAMERA = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
INPUTS = (
    topics.RGB_IMAGE, topics.DEPTH_IMAGE, topics.DETECTIONS, topics.CAMERA_INFO, topics.FEATURES,
    topics.FEATURE_VERDICTS,
)  # fmt: skip
_FRAME = 'camera_color_optical_frame'
_PERIOD_S = 1 / 15
_START_S, _BACK_S = 60.0, 5.0
_MEMORY_FACTOR, _MEMORY_MB = 1.3, 30.0
_PARAMETERS: dict[str, dict[str, Any]] = {
    FILTER: {'strategy': 'hoid2d', 'detections.wait_s': 0.1},
    SLAM: {'dense.enabled': False, 'objects.enabled': False},
}


class Sender:
    """Sends a still scene again and again, and hears what the nodes make of it."""

    def __init__(self, node: Node) -> None:
        self._executor = SteadyExecutor()
        self._executor.add_node(node)
        kinds = (Image, Image, DetectionArray, CameraInfo, Features, FeatureVerdicts)
        self.publishers: dict[str, Publisher] = {
            topic: node.create_publisher(kind, topic, qos.OUTPUT)
            for topic, kind in zip(INPUTS, kinds, strict=True)
        }
        self.odometry: list[Odometry] = []
        self.status: SlamStatus | None = None
        self.features: Features | None = None  # the first that came
        node.create_subscription(Odometry, topics.ODOM, self.odometry.append, qos.OUTPUT)
        node.create_subscription(SlamStatus, topics.SLAM_STATUS, self._on_status, qos.OUTPUT)
        # Raw, as wrong ones come back here, of which the middleware writes to the terminal.
        node.create_subscription(
            Features, topics.FEATURES, self._on_features, qos.OUTPUT, raw=True
        )
        self._scene = _scene()
        self._due_s = 0.0

    def send(self) -> dict[str, Any]:
        """Send one good instant, at its time, and return its messages."""
        while (left_s := self._due_s - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left_s)
        self._due_s = max(self._due_s, time.monotonic()) + _PERIOD_S
        messages = _messages(*self._scene, time.time_ns())
        for topic, msg in messages.items():
            self.publishers[topic].publish(msg)
        return messages

    def is_tracking_within(self, limit_s: float) -> bool:
        """Send until odometry comes of what is sent from now on; return whether it does."""
        end_s, since_ns = time.monotonic() + limit_s, time.time_ns()
        while time.monotonic() < end_s:
            self.send()
            if any(conversions.stamp_from_msg(m.header.stamp) >= since_ns for m in self.odometry):
                self.odometry.clear()
                return True
        return False

    def _on_status(self, msg: SlamStatus) -> None:
        self.status = msg

    def _on_features(self, data: bytes) -> None:
        if self.features is None:
            self.features = deserialize_message(data, Features)


def message_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield one outcome for each input: all its seeds are sent to the same nodes.

    Every wrong message lies between good ones. Afterwards the nodes must be alive, odometry must
    come within five seconds in the same number of maps, and their memory must be as before.
    """
    folder.mkdir(parents=True)
    specs = node_specs(NodeOptions((FILTER, SLAM), parameters=_PARAMETERS), folder)
    with own_domain(), Supervisor(specs, log_dir=folder) as nodes:
        rclpy.init()
        node = rclpy.create_node('faults')
        try:
            yield from _inputs(Sender(node), nodes, folder, seeds)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


def _inputs(sender: Sender, nodes: Supervisor, folder: Path, seeds: range) -> Iterator[Outcome]:
    if not sender.is_tracking_within(_START_S):
        yield Outcome('messages', seeds.start, 'the nodes do not track good messages')
        return
    for _ in range(30):
        sender.send()
    for topic in INPUTS:
        nodes.poll()
        pids, before_mb, start_s = nodes.pids, _memory_mb(nodes), time.monotonic()
        num_maps = sender.status.maps if sender.status else 0
        _send_wrong(sender, topic, np.random.default_rng(seeds.start), len(seeds))
        complaint = _after(sender, nodes, pids, num_maps) or _grown(nodes, before_mb)
        complaint = complaint or _tracebacks(folder)
        wall_s, peak_mb = time.monotonic() - start_s, max(_memory_mb(nodes).values(), default=0.0)
        kind = f'{len(seeds)} messages on {topic}'
        yield Outcome(kind, seeds.start, complaint, wall_s=wall_s, peak_mb=peak_mb)


def _send_wrong(sender: Sender, topic: str, rng: Rng, number: int) -> None:
    for _ in range(number):
        good = sender.send()
        if topic == topics.FEATURES and sender.features is not None:
            sender.features.header = good[topics.RGB_IMAGE].header
            good[topic] = sender.features
        if topic == topics.FEATURE_VERDICTS:
            header = good[topics.RGB_IMAGE].header
            good[topic] = FeatureVerdicts(header=header, dynamic=[0, 1] * 500)
        sender.publishers[topic].publish(mutated(good[topic], rng))


def _after(sender: Sender, nodes: Supervisor, pids: dict[str, int], num_maps: int) -> str:
    if exits := nodes.poll():
        return '; '.join(map(str, exits))
    if nodes.pids != pids:
        return 'a node was started anew'
    if not sender.is_tracking_within(_BACK_S):
        return f'no odometry for {_BACK_S:g} s of good messages'
    now = sender.status.maps if sender.status else 0
    return '' if now <= num_maps else f'{now} maps where there were {num_maps}'


def _grown(nodes: Supervisor, before_mb: dict[str, float]) -> str:
    for name, now_mb in _memory_mb(nodes).items():
        if now_mb > _MEMORY_FACTOR * before_mb[name] + _MEMORY_MB:
            return f'{name} has {now_mb:.0f} MB where it had {before_mb[name]:.0f}'
    return ''


def _memory_mb(nodes: Supervisor) -> dict[str, float]:
    return {
        name: psutil.Process(pid).memory_info().rss / 2**20 for name, pid in nodes.pids.items()
    }


def _tracebacks(folder: Path) -> str:
    for log in folder.glob('*.log'):
        if 'Traceback' in log.read_text(errors='replace'):
            return f'a traceback of {log.stem}'
    return ''


def _scene() -> tuple[Any, Any]:
    rng = np.random.default_rng(3)
    coarse = rng.integers(0, 256, (60, 80, 3), dtype=np.uint8)
    image = cv2.resize(coarse, CAMERA.size_px, interpolation=cv2.INTER_CUBIC)
    slope = np.linspace(1.5, 3.0, CAMERA.width_px, dtype=np.float32)
    return image, np.tile(slope, (CAMERA.height_px, 1))


def _messages(image_bgr: Any, depth_m: Any, stamp_ns: int) -> dict[str, Any]:
    header = conversions.header_to_msg(stamp_ns, _FRAME)
    cup = Detection(class_name='cup', score=0.9, x_min=50.0, y_min=50.0, x_max=90.0, y_max=90.0)
    width, height = CAMERA.size_px
    boxes = DetectionArray(header=header, image_width=width, image_height=height, detections=[cup])
    return {
        topics.CAMERA_INFO: conversions.camera_to_msg(CAMERA, header),
        topics.DEPTH_IMAGE: conversions.depth_to_msg(depth_m, header),
        topics.RGB_IMAGE: conversions.color_to_msg(image_bgr, header),
        topics.DETECTIONS: boxes,
    }
