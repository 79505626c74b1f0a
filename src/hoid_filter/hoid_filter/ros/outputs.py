"""What the filter publishes: features, verdicts, and pictures while someone listens."""

from __future__ import annotations

from hoid_msgs.msg import DynamicObjectArray
from hoid_msgs.msg import Features as FeaturesMsg
from rclpy.node import Node
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.ros.debug_image import DebugImages, MaskedImages
from hoid_common.values import FilterResult, RgbdFrame
from hoid_filter.drawing import draw_result
from hoid_filter.masked_images import static_depth_m


class FilterOutputs:
    """Publishes what the filter makes of an image, with the image's header."""

    def __init__(self, node: Node) -> None:
        self._features = node.create_publisher(FeaturesMsg, topics.FEATURES, qos.OUTPUT)
        self._objects = node.create_publisher(
            DynamicObjectArray, topics.DYNAMIC_OBJECTS, qos.OUTPUT
        )
        self._debug_images = DebugImages(node)
        self._masked_images = MaskedImages(node)

    @property
    def wants_picture(self) -> bool:
        """Return whether someone listens to the debug image."""
        return self._debug_images.is_watched

    @property
    def wants_mask(self) -> bool:
        """Return whether someone listens to the masked images."""
        return self._masked_images.is_watched

    def publish(self, frame: RgbdFrame, result: FilterResult, header: Header) -> None:
        """Publish features and verdicts, then the pictures that are wanted."""
        counts = conversions.FeatureCounts(
            result.num_features_in,
            result.num_removed,
            result.stage_ms['extract'],
            result.stage_ms['filter'],
        )
        size_px = frame.size_px
        self._features.publish(
            conversions.features_to_msg(result.features, header, size_px, counts)
        )
        self._objects.publish(conversions.dynamic_objects_to_msg(result.objects, header, size_px))
        if (mask := result.static_mask) is not None:
            self._masked_images.publish(mask, static_depth_m(frame.depth_m, mask), header)
        if self.wants_picture:
            self._debug_images.publish(draw_result(frame.image_bgr, result), header)
