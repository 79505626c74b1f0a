"""The publishers of the filter node: features, objects, final verdicts, images and points."""

from __future__ import annotations

from typing import Any

import numpy as np
from hoid_msgs.msg import DynamicObjectArray
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import FeatureVerdicts as FeatureVerdictsMsg
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.ros.debug_image import DebugImages
from hoid_common.values import BoolArray, CameraModel, FilterResult, Float32Array, RgbdFrame
from hoid_filter.drawing import draw_result
from hoid_filter.feature_filter import FinalVerdict
from hoid_filter.masked_images import dynamic_mask, points_m


class FilterOutputs:
    """Publishes the results for an image; images and clouds only while there are subscribers."""

    def __init__(self, node: Node) -> None:
        def publisher(type_: type[Any], topic: str) -> Publisher:
            return node.create_publisher(type_, topic, qos.OUTPUT)

        self._features = publisher(FeaturesMsg, topics.FEATURES)
        self._objects = publisher(DynamicObjectArray, topics.DYNAMIC_OBJECTS)
        self._verdicts = publisher(FeatureVerdictsMsg, topics.FEATURE_VERDICTS)
        self._debug_images = DebugImages(node)
        self._mask = publisher(Image, topics.MASK)
        self._static_depth = publisher(Image, topics.STATIC_DEPTH)
        self._moving_points = publisher(PointCloud2, topics.MOVING_POINTS)
        self._static_points = publisher(PointCloud2, topics.STATIC_POINTS)

    @property
    def wants_picture(self) -> bool:
        return self._debug_images.is_watched

    @property
    def wants_masks(self) -> bool:
        masked = (self._mask, self._static_depth, self._moving_points, self._static_points)
        return any(publisher.get_subscription_count() for publisher in masked)

    def publish(
        self, frame: RgbdFrame, result: FilterResult, header: Header, *, provisional: bool
    ) -> None:
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
        self._objects.publish(
            conversions.dynamic_objects_to_msg(
                result.objects, header, size_px, provisional=provisional
            )
        )
        if self.wants_picture:
            self._debug_images.publish(draw_result(frame.image_bgr, result), header)

    def publish_final(self, final: FinalVerdict, header: Header, size_px: tuple[int, int]) -> None:
        self._verdicts.publish(conversions.feature_verdicts_to_msg(final.feature_verdicts, header))
        self._objects.publish(conversions.dynamic_objects_to_msg(final.objects, header, size_px))

    def publish_masks(
        self,
        final: FinalVerdict,
        depth_m: Float32Array,
        header: Header,
        camera: CameraModel | None,
    ) -> None:
        size_px = depth_m.shape[::-1]
        is_dynamic = dynamic_mask(final.verdict, size_px)
        is_static = ~is_dynamic
        self._publish_images(is_static, depth_m, header)
        if camera is not None and camera.size_px == size_px:
            for publisher, wanted in (
                (self._moving_points, is_dynamic),
                (self._static_points, is_static),
            ):
                if publisher.get_subscription_count():
                    cloud = conversions.Cloud(points_m(depth_m, wanted, camera))
                    publisher.publish(conversions.cloud_to_msg(cloud, header))

    def _publish_images(self, is_static: BoolArray, depth_m: Float32Array, header: Header) -> None:
        if self._mask.get_subscription_count():
            mask = is_static.astype(np.uint8) * np.uint8(255)
            self._mask.publish(conversions.mask_to_msg(mask, header))
        if self._static_depth.get_subscription_count():
            static_m = np.where(is_static, depth_m, np.float32(0))
            self._static_depth.publish(conversions.depth_to_msg(static_m, header))
