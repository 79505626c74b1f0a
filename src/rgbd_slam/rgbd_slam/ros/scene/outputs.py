"""Everything that is published of the room, made in its process and sent by the SLAM node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hoid_msgs.msg import TrackedObjectArray
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from hoid_common import topics
from hoid_common.ros import conversions, qos
from rgbd_slam.ros.scene.conversions import grid_to_msg, markers_to_msg, tracked_objects_to_msg
from rgbd_slam.ros.scene.messages import Output
from rgbd_slam.scene.object_tracker import TrackedObject
from rgbd_slam.scene.scene_mapper import SceneMapper

TOPICS = {
    topics.CLOUD_MAP: (PointCloud2, qos.LATCHED),
    topics.GRID_MAP: (OccupancyGrid, qos.LATCHED),
    topics.TRACKED_OBJECTS: (TrackedObjectArray, qos.OUTPUT),
    topics.TRACKED_OBJECT_MARKERS: (MarkerArray, qos.OUTPUT),
}
"""Type and quality of service by name."""


class SceneOutputs:
    """Makes messages, all in the map frame, with the stamp of the image they came from.

    Args:
        send: Takes them to the SLAM node.
        map_frame: Name of the map frame.
    """

    def __init__(self, send: Callable[[Output], None], map_frame: str) -> None:
        self._send = send
        self._frame = map_frame

    def publish_objects(self, objects: tuple[TrackedObject, ...], stamp_ns: int) -> None:
        """Publish the tracks as known after an image."""
        header = conversions.header_to_msg(stamp_ns, self._frame)
        self._publish(topics.TRACKED_OBJECTS, tracked_objects_to_msg(objects, header))
        self._publish(topics.TRACKED_OBJECT_MARKERS, markers_to_msg(objects, header))

    def publish_map(self, room: SceneMapper, stamp_ns: int) -> None:
        """Publish cloud and, once there is a floor, grid."""
        header = conversions.header_to_msg(stamp_ns, self._frame)
        cloud = room.cloud()
        message = conversions.Cloud(cloud.points_m, cloud.colors_bgr)
        self._publish(topics.CLOUD_MAP, conversions.cloud_to_msg(message, header))
        grid = room.grid(cloud)
        if grid is not None:
            self._publish(topics.GRID_MAP, grid_to_msg(grid, header))

    def clear(self, stamp_ns: int) -> None:
        """Show that there is no map any more."""
        if stamp_ns == 0:
            return
        header = conversions.header_to_msg(stamp_ns, self._frame)
        nothing = conversions.Cloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
        self._publish(topics.CLOUD_MAP, conversions.cloud_to_msg(nothing, header))
        self._publish(topics.GRID_MAP, OccupancyGrid(header=header))
        self.publish_objects((), stamp_ns)

    def _publish(self, topic: str, message: Any) -> None:
        self._send(Output(topic, serialize_message(message)))
