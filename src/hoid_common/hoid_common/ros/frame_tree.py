"""Publishing and listening of transforms; the pip wheels of rclpy lack tf2_ros."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from hoid_common import topics
from hoid_common.errors import MessageError
from hoid_common.inputs.registration import DepthAligner
from hoid_common.poses.frames import PoseBuffer, StaticFrames
from hoid_common.ros import qos
from hoid_common.ros.conversions import stamp_from_msg, transform_from_msg, transform_to_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.inputs import Inputs, checked_callback
from hoid_common.values import CameraModel, Float32Array, FloatArray

_REGISTER = (
    'let the driver register it, or publish camera_info beside depth and the transform between '
    'both frames on /tf_static'
)


class TransformPublisher:
    """Publishes transforms on /tf."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(TFMessage, topics.TF, qos.TF)
        self.sent: list[tuple[str, str, FloatArray]] = []  # the edges of the last message

    def send(self, stamp_ns: int, edges: list[tuple[str, str, FloatArray]]) -> None:
        """Publish edges (parent, child, T_parent_child) at one stamp."""
        self.sent = edges
        self._publisher.publish(
            TFMessage(
                transforms=[
                    transform_to_msg(T, stamp_ns, parent, child) for parent, child, T in edges
                ]
            )
        )


def listen_to_transforms(
    node: Node,
    topic: str,
    profile: QoSProfile,
    what: str,
    take: Callable[[TransformStamped], None],
    diagnostics: Diagnostics,
) -> None:
    """Subscribe to `topic` (/tf or /tf_static), and call `take` with each valid transform.

    Malformed messages, and those for which `take` raises MessageError, are counted and logged.
    """

    def on_transforms(msg: TFMessage) -> None:
        for edge in msg.transforms:
            # A leading slash, as in the names of tf1, is removed, as tf2 does.
            edge.header.frame_id = edge.header.frame_id.lstrip('/')
            edge.child_frame_id = edge.child_frame_id.lstrip('/')
            try:
                take(edge)
            except MessageError as error:
                diagnostics.report(error, f'{what} refused')

    full_name = node.resolve_topic_name(topic)
    on_bytes = checked_callback(on_transforms, TFMessage, full_name, what, diagnostics)
    node.create_subscription(TFMessage, topic, on_bytes, profile, raw=True)


class StaticFrameListener:
    """Collects transforms on /tf_static in `frames`; malformed edges are counted and logged."""

    def __init__(self, node: Node, diagnostics: Diagnostics) -> None:
        self.frames = StaticFrames()
        listen_to_transforms(
            node, topics.TF_STATIC, qos.TF_STATIC, 'static transforms', self._add, diagnostics
        )

    def _add(self, edge: TransformStamped) -> None:
        self.frames.add(edge.header.frame_id, edge.child_frame_id, transform_from_msg(edge))


class LiveAlignment:
    """Registers the depth images of a node to its color images, and reports doubts about them."""

    def __init__(self, node: Node, inputs: Inputs, diagnostics: Diagnostics) -> None:
        self.aligner = DepthAligner(_REGISTER)
        self.aligner.frames = StaticFrameListener(node, diagnostics).frames
        self._logger, self._diagnostics, self._noted = node.get_logger(), diagnostics, ''
        inputs.depth_camera(self._on_camera)

    def _on_camera(self, camera: CameraModel) -> None:
        self.aligner.depth = camera

    def align(
        self, depth_m: Float32Array, depth: Header, color: Header, size_px: tuple[int, int]
    ) -> Float32Array:
        """Return the depth (H, W) in m at the color pixels of depth (h, w); 0 = no measurement.

        MessageError if depth and color differ in size and depth is not registered.
        """
        try:
            return self.aligner.align(depth_m, depth.frame_id, color.frame_id, size_px)
        finally:
            self._diagnostics.report_problem('registration', self.aligner.doubt)
            if self.aligner.note and self.aligner.note != self._noted:
                self._logger.info(self.aligner.note)
            self._noted = self.aligner.note


class FrameListener:
    """Finds the transform between two frames at a time, like tf2's `lookup_transform`."""

    def __init__(self, node: Node) -> None:
        self._static = StaticFrames()
        self._moving: dict[tuple[str, str], PoseBuffer] = {}  # by parent and child
        for topic, profile in ((topics.TF, qos.TF), (topics.TF_STATIC, qos.TF_STATIC)):
            is_static = topic == topics.TF_STATIC
            node.create_subscription(
                TFMessage, topic, partial(self._on_transforms, is_static=is_static), profile
            )

    def find(self, a: str, b: str, stamp_ns: int) -> FloatArray | None:
        """Return T_a_b (4, 4) between two frames at a time; None if it is unknown."""
        poses = ((*edge, buffer.at(stamp_ns)) for edge, buffer in self._moving.items())
        known = [(parent, child, T) for parent, child, T in poses if T is not None]
        return self._static.with_edges(known).find(a.lstrip('/'), b.lstrip('/'))

    def _on_transforms(self, msg: TFMessage, *, is_static: bool) -> None:
        for edge in msg.transforms:
            names = edge.header.frame_id.lstrip('/'), edge.child_frame_id.lstrip('/')
            if is_static:
                self._static.add(*names, transform_from_msg(edge))
            else:
                poses = self._moving.setdefault(names, PoseBuffer())
                poses.add(stamp_from_msg(edge.header.stamp), transform_from_msg(edge))
