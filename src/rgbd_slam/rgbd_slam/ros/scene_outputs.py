"""Everything that is published of the room."""

from __future__ import annotations

import numpy as np
from hoid_msgs.msg import TrackedObjectArray
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from hoid_common import topics
from hoid_common.ros import conversions, qos
from rgbd_slam.ros.scene_messages import grid_to_msg, markers_to_msg, tracked_objects_to_msg
from rgbd_slam.ros.scene_setup import SceneSetup
from rgbd_slam.scene.object_tracker import TrackedObject
from rgbd_slam.scene.scene_mapper import SceneMapper


class SceneOutputs:
    """Publishers; every message is in the map frame, with the stamp of the image it came from."""

    def __init__(self, node: Node, setup: SceneSetup) -> None:
        self._frame = setup.map_frame
        self._cloud = node.create_publisher(PointCloud2, topics.CLOUD_MAP, qos.LATCHED)
        self._grid = node.create_publisher(OccupancyGrid, topics.GRID_MAP, qos.LATCHED)
        self._objects = node.create_publisher(
            TrackedObjectArray, topics.TRACKED_OBJECTS, qos.OUTPUT
        )
        self._markers = node.create_publisher(
            MarkerArray, topics.TRACKED_OBJECT_MARKERS, qos.OUTPUT
        )

    def publish_objects(self, objects: tuple[TrackedObject, ...], stamp_ns: int) -> None:
        """Publish the tracks as known after an image."""
        header = conversions.header_to_msg(stamp_ns, self._frame)
        self._objects.publish(tracked_objects_to_msg(objects, header))
        if self._markers.get_subscription_count():
            self._markers.publish(markers_to_msg(objects, header))

    def publish_map(self, room: SceneMapper, stamp_ns: int) -> None:
        """Publish cloud and, once there is a floor, grid."""
        header = conversions.header_to_msg(stamp_ns, self._frame)
        cloud = room.cloud()
        message = conversions.Cloud(cloud.points_m, cloud.colors_bgr)
        self._cloud.publish(conversions.cloud_to_msg(message, header))
        grid = room.grid(cloud)
        if grid is not None:
            self._grid.publish(grid_to_msg(grid, header))

    def clear(self, stamp_ns: int) -> None:
        """Show that there is no map any more."""
        if stamp_ns == 0:
            return
        header = conversions.header_to_msg(stamp_ns, self._frame)
        nothing = conversions.Cloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
        self._cloud.publish(conversions.cloud_to_msg(nothing, header))
        self._grid.publish(OccupancyGrid(header=header))
        self.publish_objects((), stamp_ns)
