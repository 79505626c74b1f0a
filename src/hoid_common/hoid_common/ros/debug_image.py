"""Publishing of debug images."""

from __future__ import annotations

from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.values import ByteArray

_JPEG_QUALITY = 80  # of 100; chosen, not tuned


class DebugImages:
    """Publishes debug images on a raw and a JPEG topic, each only while it has a subscriber."""

    def __init__(self, node: Node) -> None:
        self._raw = node.create_publisher(Image, topics.DEBUG_IMAGE, qos.OUTPUT)
        self._compressed = node.create_publisher(
            CompressedImage, topics.compressed(topics.DEBUG_IMAGE), qos.OUTPUT
        )

    @property
    def is_watched(self) -> bool:
        publishers = (self._raw, self._compressed)
        return any(publisher.get_subscription_count() for publisher in publishers)

    def publish(self, image_bgr: ByteArray, header: Header) -> None:
        if self._raw.get_subscription_count():
            self._raw.publish(conversions.color_to_msg(image_bgr, header))
        if self._compressed.get_subscription_count():
            msg = conversions.compressed_color_to_msg(image_bgr, header, _JPEG_QUALITY)
            self._compressed.publish(msg)
