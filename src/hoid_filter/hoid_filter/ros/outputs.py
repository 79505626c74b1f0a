"""The publishers of the filter node: features, objects, final verdicts, images and points."""

from __future__ import annotations

import numpy as np
from hoid_msgs.msg import DynamicObjectArray
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import FeatureVerdicts as FeatureVerdictsMsg
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.ros.debug_image import DebugImages, MaskedImages
from hoid_common.values import CameraModel, DynamicObject, FilterResult, Float32Array, RgbdFrame
from hoid_filter.drawing import draw_result
from hoid_filter.feature_filter import FinalVerdict
from hoid_filter.masked_images import dynamic_mask, points_m


class FilterOutputs:
    """Publishes the results for an image; images and clouds only while somebody subscribes."""

    def __init__(self, node: Node) -> None:
        self._features = node.create_publisher(FeaturesMsg, topics.FEATURES, qos.OUTPUT)
        self._objects = node.create_publisher(
            DynamicObjectArray, topics.DYNAMIC_OBJECTS, qos.OUTPUT
        )
        self._verdicts = node.create_publisher(
            FeatureVerdictsMsg, topics.FEATURE_VERDICTS, qos.OUTPUT
        )
        self._debug_images = DebugImages(node)
        self._masked_images = MaskedImages(node)
        self._moving_points = node.create_publisher(PointCloud2, topics.MOVING_POINTS, qos.OUTPUT)
        self._static_points = node.create_publisher(PointCloud2, topics.STATIC_POINTS, qos.OUTPUT)

    @property
    def wants_picture(self) -> bool:
        return self._debug_images.is_watched

    @property
    def wants_masks(self) -> bool:
        return self._masked_images.is_watched or bool(self._watched_clouds())

    def publish(
        self,
        frame: RgbdFrame,
        result: FilterResult,
        header: Header,
        *,
        provisional: bool,
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
        self._publish_objects(result.objects, header, size_px, provisional=provisional)
        if self.wants_picture:
            self._debug_images.publish(draw_result(frame.image_bgr, result), header)

    def publish_masks(
        self,
        final: FinalVerdict,
        depth_m: Float32Array,
        header: Header,
        camera: CameraModel | None,
    ) -> None:
        is_dynamic = dynamic_mask(final.verdict, depth_m.shape[::-1])
        is_static = ~is_dynamic
        mask = is_static.astype(np.uint8) * np.uint8(255)
        self._masked_images.publish(mask, np.where(is_static, depth_m, np.float32(0)), header)
        if camera is None or camera.size_px != depth_m.shape[::-1]:
            return
        for publisher in self._watched_clouds():
            wanted = is_dynamic if publisher is self._moving_points else is_static
            cloud = conversions.Cloud(points_m(depth_m, wanted, camera))
            publisher.publish(conversions.cloud_to_msg(cloud, header))

    def publish_final(self, final: FinalVerdict, header: Header, size_px: tuple[int, int]) -> None:
        self._verdicts.publish(conversions.feature_verdicts_to_msg(final.feature_verdicts, header))
        self._publish_objects(final.objects, header, size_px, provisional=False)

    def _publish_objects(
        self,
        objects: tuple[DynamicObject, ...],
        header: Header,
        size_px: tuple[int, int],
        *,
        provisional: bool,
    ) -> None:
        self._objects.publish(
            conversions.dynamic_objects_to_msg(objects, header, size_px, provisional=provisional)
        )

    def _watched_clouds(self) -> list[Publisher]:
        clouds = (self._moving_points, self._static_points)
        return [publisher for publisher in clouds if publisher.get_subscription_count()]
