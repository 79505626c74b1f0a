"""A subscriber of the nodes' outputs, which measures the latency of odometry."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hoid_msgs.msg import (
    DetectionArray,
    DynamicObjectArray,
    Features,
    FeatureVerdicts,
    SlamStatus,
    TrackedObjectArray,
)
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from people_msgs.msg import People
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from hoid_bringup.live.live_metrics import LiveMetrics
from hoid_common import topics
from hoid_common.inputs.input_config import BEST_EFFORT, RELIABLE
from hoid_common.ros import qos
from hoid_common.ros.conversions import stamp_from_msg
from hoid_common.ros.execution.executor import SteadyExecutor

_QUEUE = 200  # chosen: messages of some seconds
_LATCHED = {
    topics.PATH: Path,
    topics.MAP_POINTS: PointCloud2,
    topics.KEYFRAMES: MarkerArray,
    topics.CLOUD_MAP: PointCloud2,
    topics.GRID_MAP: OccupancyGrid,
    topics.SLAM_STATUS: SlamStatus,
}
# All outputs besides odometry that are always on; images that are made for subscribers only are
# left out, as a robot uses few of them.
_OTHERS = {
    topics.DETECTIONS: DetectionArray,
    topics.FEATURES: Features,
    topics.FEATURE_VERDICTS: FeatureVerdicts,
    topics.DYNAMIC_OBJECTS: DynamicObjectArray,
    topics.GRID_MAP_UPDATES: OccupancyGridUpdate,
    topics.TRACKED_OBJECTS: TrackedObjectArray,
    topics.TRACKED_OBJECT_MARKERS: MarkerArray,
    topics.PEOPLE: People,
    topics.TF: TFMessage,
    topics.DIAGNOSTICS: DiagnosticArray,
}
_PAUSE_S = 0.02  # chosen: waking at each message would take processor time from the nodes


class Listener:
    """Subscribes to odometry, and to all other outputs if `everything` is set.

    Args:
        node: Node of this process.
        camera_info: Topic of the camera_info messages, which are published with the images.
        everything: Whether to subscribe to all outputs.
    """

    def __init__(self, node: Node, camera_info: str, *, everything: bool) -> None:
        self.metrics = LiveMetrics()
        self.received: Counter[str] = Counter()  # messages by topic
        self._node = node
        self._executor = SteadyExecutor()
        self._executor.add_node(node)
        self._camera_info = node.create_publisher(CameraInfo, camera_info, qos.OUTPUT)
        best_effort = qos.input_qos(BEST_EFFORT, _QUEUE)
        node.create_subscription(CameraInfo, camera_info, self._on_camera, best_effort)
        reliable = qos.input_qos(RELIABLE, _QUEUE)
        node.create_subscription(Odometry, topics.ODOM, self._on_odometry, reliable)
        if everything:
            for topic, type_ in _LATCHED.items():
                self._subscribe(type_, topic, qos.LATCHED)
            for topic, type_ in _OTHERS.items():
                self._subscribe(type_, topic, reliable)

    def spin(self, duration_s: float) -> None:
        """Receive messages for a time."""
        end_s = time.monotonic() + duration_s
        while (left_s := end_s - time.monotonic()) > 0:
            if not self._executor.spin_ready():
                time.sleep(min(left_s, _PAUSE_S))

    def is_connected(self) -> bool:
        """Return whether the SLAM node publishes odometry, and receives features and cameras."""
        return bool(
            self._node.count_publishers(topics.ODOM)
            and self._node.count_publishers(topics.FEATURES)
            and self._node.count_subscribers(topics.FEATURES)
            and self._camera_info.get_subscription_count() > 1  # the listener's own
        )

    def send_camera(self, serialized: bytes) -> None:
        """Publish a camera info, after which the SLAM node starts its processes."""
        self._camera_info.publish(serialized)

    def _subscribe(self, type_: type[Any], topic: str, profile: Any) -> None:
        count = partial(self._count, topic)
        self._node.create_subscription(type_, topic, count, profile, raw=True)

    def _count(self, topic: str, _: bytes) -> None:
        self.received[topic] += 1

    def _on_camera(self, msg: CameraInfo, info: Mapping[str, int]) -> None:
        self.metrics.published_ns[stamp_from_msg(msg.header.stamp)] = info['source_timestamp']

    def _on_odometry(self, msg: Odometry, info: Mapping[str, int]) -> None:
        self.metrics.odometry_ns[stamp_from_msg(msg.header.stamp)] = info['received_timestamp']
        self.received[topics.ODOM] += 1
