"""What the filter publishes: features, verdicts; pictures and points while someone listens."""

from __future__ import annotations

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
from hoid_filter.feature_filter import FinalWord
from hoid_filter.masked_images import pixel_masks, points_m, static_depth_m


class FilterOutputs:
    """Publishes what the filter makes of an image, with the image's header."""

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
        """Return whether someone listens to the debug image."""
        return self._debug_images.is_watched

    @property
    def wants_masks(self) -> bool:
        """Return whether someone listens to the masked images or the points."""
        return self._masked_images.is_watched or bool(self._watched_clouds())

    def publish(
        self,
        frame: RgbdFrame,
        result: FilterResult,
        header: Header,
        *,
        provisional: bool,
    ) -> None:
        """Publish features and verdicts, then the picture if it is wanted.

        Args:
            frame: The image.
            result: What the filter made of it.
            header: Of the image.
            provisional: Whether `publish_final` is to follow.
        """
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
        self, word: FinalWord, depth_m: Float32Array, header: Header, camera: CameraModel | None
    ) -> None:
        """Publish the masked images and the points that are wanted.

        Args:
            word: What is known of the image by now.
            depth_m: (H, W) of the image.
            header: Of the image.
            camera: That took it; without it, or with one of another size, there are no points.
        """
        masks = pixel_masks(word.verdict, depth_m.shape[::-1])
        self._masked_images.publish(masks.static, static_depth_m(depth_m, masks.static), header)
        if camera is None or camera.size_px != depth_m.shape[::-1]:
            return
        for publisher in self._watched_clouds():
            wanted = masks.moving if publisher is self._moving_points else ~masks.moving
            cloud = conversions.Cloud(points_m(depth_m, wanted, camera))
            publisher.publish(conversions.cloud_to_msg(cloud, header))

    def publish_final(self, word: FinalWord, header: Header, size_px: tuple[int, int]) -> None:
        """Publish the final word on an image of which only a provisional one is known."""
        self._verdicts.publish(conversions.feature_verdicts_to_msg(word.verdicts, header))
        self._publish_objects(word.objects, header, size_px, provisional=False)

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
