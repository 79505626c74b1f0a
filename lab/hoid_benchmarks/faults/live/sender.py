"""A simulated camera that looks at a wall, and subscriptions to the outputs of the nodes."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from hoid_msgs.msg import Detection, DetectionArray, Features, SlamStatus, TrackedObjectArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image
from tf2_msgs.msg import TFMessage

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.values import CameraModel, Detections

CAMERA = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
FRAME = 'camera_color_optical_frame'
OWN_DETECTIONS = 'own_detections'
"""Output of the detector node, remapped because the sender publishes `detections` itself."""
RATE_HZ = 15.0
WALL_M, _TRAVEL_M = 2.0, 0.3
_BLOCKS = 80  # of the wall's texture, per image width
_QUALITY = 90
_SLOW_IMAGES = 8  # a slow detector answers one image in so many


class Scene:
    """A textured wall: slanted before a still camera, or flat before one that moves to and fro."""

    def __init__(self, camera: CameraModel = CAMERA, step_px: int = 0) -> None:
        self.camera, self._step_px = camera, step_px
        width_px, height_px = camera.size_px
        # Whole millimeters, which compression preserves.
        slope = np.linspace(1.5, 3.0, width_px, dtype=np.float32).round(3)
        self._depth_m = np.tile(slope, (height_px, 1))
        self._num_steps = 0
        if step_px:
            self._depth_m[:] = WALL_M
            self._num_steps = round(_TRAVEL_M * camera.fx_px / WALL_M) // step_px
        wall_px = width_px + self._num_steps * step_px, height_px
        blocks = [side * _BLOCKS // width_px for side in wall_px]
        coarse = np.random.default_rng(3).integers(0, 256, (*blocks[::-1], 3), dtype=np.uint8)
        self._wall = cv2.resize(coarse, wall_px, interpolation=cv2.INTER_CUBIC)

    def view(self, i: int) -> tuple[Any, Any, float]:
        """Return color (H, W, 3) uint8, depth (H, W) float32 in m and camera position in m."""
        steps = self._num_steps - abs(self._num_steps - i % max(2 * self._num_steps, 1))
        first_px = steps * self._step_px
        image_bgr = self._wall[:, first_px : first_px + self.camera.width_px]
        place_m = first_px * WALL_M / self.camera.fx_px
        return np.ascontiguousarray(image_bgr), self._depth_m, place_m


class Heard(NamedTuple):
    """A received odometry message."""

    received_s: float  # monotonic
    stamp_ns: int
    position_m: tuple[float, float, float]


class Sender:
    """Publishes images of a scene at a rate, and records the outputs of the nodes.

    Args:
        node: The ROS node that publishes and subscribes.
        scene: The rendered scene.
        rate_hz: Rate of the images.
        is_compressed: Whether images are published as JPEG and compressed depth.
        is_foreign: Whether boxes as vision_msgs, odometry on /tf and /clock are published too.
    """

    def __init__(
        self, node: Node, scene: Scene, rate_hz: float = RATE_HZ, *, is_compressed: bool = False,
        is_foreign: bool = False,
    ) -> None:  # fmt: skip
        self.node, self.scene, self.period_s = node, scene, 1 / rate_hz
        self._executor = SteadyExecutor()
        self._executor.add_node(node)
        self._make = _compressed if is_compressed else _raw
        self._is_foreign = is_foreign
        self._publishers: dict[str, Publisher] = {}
        self.sent: dict[int, float] = {}  # camera position [m] by stamp
        self.sent_s: dict[int, float] = {}  # monotonic time of publishing by stamp
        self.heard: list[Heard] = []
        self.newest_ns: dict[str, int] = {}  # stamp of the latest message by output
        self.status: SlamStatus | None = None
        self.features: Features | None = None  # the first message
        self._diagnostics: dict[str, str] = {}  # latest message by name of the status
        self.ahead_ns = 0  # offset of the stamps from the system clock
        self.is_detector_slow = False  # boxes of one image in eight, half a second late
        self._waiting: list[DetectionArray] = []
        self.sending_s = 0.0  # total time spent in calls of `publish`
        node.create_subscription(Odometry, topics.ODOM, self._on_odometry, qos.OUTPUT)
        node.create_subscription(SlamStatus, topics.SLAM_STATUS, self._on_status, qos.OUTPUT)
        node.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.OUTPUT
        )
        for type_, topic in (
            (DetectionArray, OWN_DETECTIONS),
            (TrackedObjectArray, topics.TRACKED_OBJECTS),
        ):
            node.create_subscription(type_, topic, self._stamp_recorder(topic), qos.OUTPUT)
        # Raw: wrong messages arrive here too, and deserializing them prints warnings.
        node.create_subscription(
            Features, topics.FEATURES, self._on_features, qos.OUTPUT, raw=True
        )
        self._due_s = 0.0

    def send(self) -> dict[str, Any]:
        """Publish the messages of the next image when it is due, and return them by topic."""
        self.spin_until(self._due_s)
        self._due_s = max(self._due_s, time.monotonic()) + self.period_s
        image_bgr, depth_m, place_m = self.scene.view(len(self.sent))
        stamp_ns = self.now_ns()
        self.sent[stamp_ns], self.sent_s[stamp_ns] = place_m, time.monotonic()
        header = conversions.header_to_msg(stamp_ns, FRAME)
        messages = {
            topics.CAMERA_INFO: conversions.camera_to_msg(self.scene.camera, header),
            **self._make(image_bgr, depth_m, header),
            topics.DETECTIONS: _boxes(self.scene.camera, header),
        }
        if self.is_detector_slow:
            self._waiting.append(messages.pop(topics.DETECTIONS))
            if len(self._waiting) == _SLOW_IMAGES:
                messages[topics.DETECTIONS] = self._waiting[0]
                self._waiting.clear()
        if self._is_foreign:
            messages = _foreign(header) | messages
        for topic, msg in messages.items():
            self.publish(topic, msg)
        return messages

    def publish(self, topic: str, msg: Any, type_: type[Any] | None = None) -> None:
        """Publish a message, or serialized bytes of the type `type_`."""
        if topic not in self._publishers:
            profile = qos.TF_STATIC if topic == topics.TF_STATIC else qos.OUTPUT
            self._publishers[topic] = self.node.create_publisher(
                type_ or type(msg), topic, profile
            )
        begun_s = time.monotonic()
        self._publishers[topic].publish(msg)
        self.sending_s += time.monotonic() - begun_s

    def now_ns(self) -> int:
        """Return the stamp (ns) of an image taken now."""
        return time.time_ns() + self.ahead_ns

    def spin_until(self, end_s: float) -> None:
        """Process subscriptions until a monotonic time."""
        while (left_s := end_s - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left_s)

    def send_for(self, duration_s: float) -> float:
        """Publish images for some time; return the share of them that have odometry."""
        before = len(self.sent)
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self.send()
        return self.share_since(before)

    def share_since(self, first: int) -> float:
        """Return the share of images with odometry, from the image with this number on."""
        self.spin_until(time.monotonic() + 0.5)
        sent = list(self.sent)[first:]
        return len(set(sent) & {heard.stamp_ns for heard in self.heard}) / len(sent)

    def missing_outputs(self, limit_s: float, outputs: tuple[str, ...]) -> tuple[str, ...]:
        """Publish images until every output answers one; return the outputs that did not."""
        end_s, since_ns = time.monotonic() + limit_s, self.now_ns()
        self.newest_ns.clear()
        while time.monotonic() < end_s:
            self.send()
            now_ns = self.now_ns()
            if not (left := tuple(o for o in outputs if not self._is_new(o, since_ns, now_ns))):
                break
        return left

    def latest_diagnostics(self) -> str:
        """Return the latest message of each status on /diagnostics."""
        return ', '.join(f'{name}: {text}' for name, text in sorted(self._diagnostics.items()))

    def _is_new(self, output: str, since_ns: int, now_ns: int) -> bool:
        return since_ns <= self.newest_ns.get(output, 0) <= now_ns

    def _stamp_recorder(self, topic: str) -> Any:
        def on_message(msg: Any) -> None:
            self.newest_ns[topic] = conversions.stamp_from_msg(msg.header.stamp)

        return on_message

    def _on_odometry(self, msg: Odometry) -> None:
        stamp_ns, place = conversions.stamp_from_msg(msg.header.stamp), msg.pose.pose.position
        self.newest_ns[topics.ODOM] = stamp_ns
        self.heard.append(Heard(time.monotonic(), stamp_ns, (place.x, place.y, place.z)))

    def _on_status(self, msg: SlamStatus) -> None:
        self.status = msg

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self._diagnostics |= {status.name: status.message for status in msg.status}

    def _on_features(self, data: bytes) -> None:
        if self.features is None:
            self.features = deserialize_message(data, Features)


def _raw(image_bgr: Any, depth_m: Any, header: Any) -> dict[str, Image]:
    return {
        topics.DEPTH_IMAGE: conversions.depth_to_msg(depth_m, header),
        topics.RGB_IMAGE: conversions.color_to_msg(image_bgr, header),
    }


def _compressed(image_bgr: Any, depth_m: Any, header: Any) -> dict[str, CompressedImage]:
    depth, color = topics.compressed_depth(topics.DEPTH_IMAGE), topics.compressed(topics.RGB_IMAGE)
    return {
        depth: conversions.compressed_depth_to_msg(depth_m, header),
        color: conversions.compressed_color_to_msg(image_bgr, header, _QUALITY),
    }


def _foreign(header: Any) -> dict[str, Any]:
    stamp_ns = conversions.stamp_from_msg(header.stamp)
    wheels = TransformStamped(
        header=conversions.header_to_msg(stamp_ns, 'odom'), child_frame_id=FRAME
    )
    box = np.array([[50.0, 50.0, 90.0, 90.0]], np.float32)
    boxes = Detections(stamp_ns, box, ('cup',), np.array([0.9], np.float32))
    return {
        topics.CLOCK: Clock(clock=header.stamp),
        topics.TF: TFMessage(transforms=[wheels]),
        topics.DETECTIONS_2D: conversions.detections_2d_to_msg(boxes, header),
    }


def _boxes(camera: CameraModel, header: Any) -> DetectionArray:
    width_px, height_px = camera.size_px
    cup = Detection(class_name='cup', score=0.9, x_min=50.0, y_min=50.0, x_max=90.0, y_max=90.0)
    return DetectionArray(
        header=header, image_width=width_px, image_height=height_px, detections=[cup]
    )
