"""Publishers of debug images and masked images; without subscribers, nothing is published."""

from __future__ import annotations

from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.values import ByteArray, Float32Array

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


class MaskedImages:
    """Publishes the mask of static pixels, and depth without dynamic objects, for other SLAM."""

    def __init__(self, node: Node) -> None:
        self._mask = node.create_publisher(Image, topics.MASK, qos.OUTPUT)
        self._depth = node.create_publisher(Image, topics.STATIC_DEPTH, qos.OUTPUT)

    @property
    def is_watched(self) -> bool:
        return any(p.get_subscription_count() for p in (self._mask, self._depth))

    def publish(self, mask: ByteArray, depth_m: Float32Array, header: Header) -> None:
        """Publish the mask (H, W), 255 = static, and the depth (H, W) of static pixels in m."""
        if self._mask.get_subscription_count():
            self._mask.publish(conversions.mask_to_msg(mask, header))
        if self._depth.get_subscription_count():
            self._depth.publish(conversions.depth_to_msg(depth_m, header))
