"""Sends a still scene as a camera would, and hears what the nodes make of it."""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np
from hoid_msgs.msg import Detection, DetectionArray, Features, FeatureVerdicts, SlamStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.values import CameraModel

CAMERA = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
FRAME = 'camera_color_optical_frame'
INPUTS = (
    topics.RGB_IMAGE, topics.DEPTH_IMAGE, topics.DETECTIONS, topics.CAMERA_INFO, topics.FEATURES,
    topics.FEATURE_VERDICTS,
)  # fmt: skip
_PERIOD_S = 1 / 15


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
        self._scene = still_scene()
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


def still_scene() -> tuple[Any, Any]:
    """Return colour (H, W, 3) uint8 and depth (H, W) float32, in m, rich in corners."""
    rng = np.random.default_rng(3)
    coarse = rng.integers(0, 256, (60, 80, 3), dtype=np.uint8)
    image = cv2.resize(coarse, CAMERA.size_px, interpolation=cv2.INTER_CUBIC)
    slope = np.linspace(1.5, 3.0, CAMERA.width_px, dtype=np.float32)
    return image, np.tile(slope, (CAMERA.height_px, 1))


def _messages(image_bgr: Any, depth_m: Any, stamp_ns: int) -> dict[str, Any]:
    header = conversions.header_to_msg(stamp_ns, FRAME)
    cup = Detection(class_name='cup', score=0.9, x_min=50.0, y_min=50.0, x_max=90.0, y_max=90.0)
    width, height = CAMERA.size_px
    boxes = DetectionArray(header=header, image_width=width, image_height=height, detections=[cup])
    return {
        topics.CAMERA_INFO: conversions.camera_to_msg(CAMERA, header),
        topics.DEPTH_IMAGE: conversions.depth_to_msg(depth_m, header),
        topics.RGB_IMAGE: conversions.color_to_msg(image_bgr, header),
        topics.DETECTIONS: boxes,
    }
