"""Transforms on /tf and /tf_static, without tf2, which the wheels lack."""

from __future__ import annotations

from rclpy.node import Node
from tf2_msgs.msg import TFMessage

from hoid_common import topics
from hoid_common.errors import MessageError
from hoid_common.ros import qos
from hoid_common.ros.conversions import transform_from_msg, transform_to_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.static_frames import StaticFrames
from hoid_common.values import FloatArray


class TransformPublisher:
    """Publishes edges of the frame tree on /tf."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(TFMessage, topics.TF, qos.TF)
        self.sent: list[tuple[str, str, FloatArray]] = []  # the latest, as `send` takes them

    def send(self, stamp_ns: int, edges: list[tuple[str, str, FloatArray]]) -> None:
        """Publish edges (parent, child, T_parent_child) that hold at one time."""
        self.sent = edges
        self._publisher.publish(
            TFMessage(
                transforms=[
                    transform_to_msg(T, stamp_ns, parent, child) for parent, child, T in edges
                ]
            )
        )


class StaticFrameListener:
    """Keeps what /tf_static says."""

    def __init__(self, node: Node, diagnostics: Diagnostics) -> None:
        self.frames = StaticFrames()
        self._diagnostics = diagnostics
        self._subscription = node.create_subscription(
            TFMessage, topics.TF_STATIC, self._on_transforms, qos.TF_STATIC
        )

    def _on_transforms(self, msg: TFMessage) -> None:
        for edge in msg.transforms:
            try:
                T = transform_from_msg(edge)
            except MessageError as error:
                self._diagnostics.report(error, 'static transforms refused')
            else:
                self.frames.add(edge.header.frame_id, edge.child_frame_id, T)
