"""Everything that is published of the room, made in its process and sent by the SLAM node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hoid_msgs.msg import TrackedObjectArray
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
from people_msgs.msg import People
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.values import FloatArray
from rgbd_slam.ros.scene.conversions import (
    grid_to_msg,
    markers_to_msg,
    patch_to_msg,
    people_to_msg,
    tracked_objects_to_msg,
)
from rgbd_slam.ros.scene.messages import Output, SceneSetup
from rgbd_slam.ros.scene.steady_grid import SteadyGrid
from rgbd_slam.scene.grid import Grid
from rgbd_slam.scene.object_tracker import TrackedObject
from rgbd_slam.scene.scene_mapper import SceneMapper
from rgbd_slam.scene.voxel_map import ColoredCloud

TOPICS = {
    topics.CLOUD_MAP: (PointCloud2, qos.LATCHED),
    topics.GRID_MAP: (OccupancyGrid, qos.LATCHED),
    topics.GRID_MAP_UPDATES: (OccupancyGridUpdate, qos.OUTPUT),
    topics.TF_STATIC: (TFMessage, qos.TF_STATIC),
    topics.TRACKED_OBJECTS: (TrackedObjectArray, qos.OUTPUT),
    topics.PEOPLE: (People, qos.OUTPUT),
    topics.TRACKED_OBJECT_MARKERS: (MarkerArray, qos.OUTPUT),
}
"""Type and quality of service by name."""


class SceneOutputs:
    """Makes messages, in the map frame but for the grid, with the stamps of their images.

    Args:
        send: Takes them to the SLAM node.
        setup: Names the map frame, and says whether that is level; if not, the grid has a frame of
            its own beside it, which is.
    """

    def __init__(self, send: Callable[[Output], None], setup: SceneSetup) -> None:
        self._send = send
        self._frame, self._is_map_level = setup.map_frame, setup.is_map_level
        self._steady = SteadyGrid()
        self._T_map_level: FloatArray | None = None  # that was sent

    def publish_objects(self, objects: tuple[TrackedObject, ...], stamp_ns: int) -> None:
        """Publish the tracks as known after an image."""
        header = conversions.header_to_msg(stamp_ns, self._frame)
        self._publish(topics.TRACKED_OBJECTS, tracked_objects_to_msg(objects, header))
        self._publish(topics.PEOPLE, people_to_msg(objects, header))
        self._publish(topics.TRACKED_OBJECT_MARKERS, markers_to_msg(objects, header))

    def publish_map(self, room: SceneMapper, stamp_ns: int) -> None:
        """Publish cloud and, once there is a floor, grid."""
        header = conversions.header_to_msg(stamp_ns, self._frame)
        cloud = room.cloud()
        message = conversions.Cloud(cloud.points_m, cloud.colors_bgr)
        self._publish(topics.CLOUD_MAP, conversions.cloud_to_msg(message, header))
        grid = self.placed_grid(room, cloud)
        if grid is not None:
            self._publish_grid(grid, stamp_ns)

    def placed_grid(self, room: SceneMapper, cloud: ColoredCloud) -> Grid | None:
        """Return the grid of a cloud of the room as it is published; None without a floor."""
        grid = room.grid(cloud)
        return None if grid is None else self._steady.place(grid)

    def clear(self, stamp_ns: int) -> None:
        """Show that there is no map any more."""
        if stamp_ns == 0:
            return
        header = conversions.header_to_msg(stamp_ns, self._frame)
        nothing = conversions.Cloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
        self._publish(topics.CLOUD_MAP, conversions.cloud_to_msg(nothing, header))
        self._publish(topics.GRID_MAP, OccupancyGrid(header=header))
        self._steady.clear()
        self.publish_objects((), stamp_ns)

    def _publish_grid(self, grid: Grid, stamp_ns: int) -> None:
        """Publish the whole grid, for who comes late, and what of it changed."""
        frame, height_m = self._frame, float(grid.T_map_origin[2, 3])
        if not self._is_map_level:
            frame, height_m = f'{self._frame}_level', 0.0
            self._publish_level(grid.T_map_level, stamp_ns, frame)
        header = conversions.header_to_msg(stamp_ns, frame)
        patch = self._steady.show(grid)
        self._publish(topics.GRID_MAP, grid_to_msg(grid, header, height_m))
        if patch is not None:
            self._publish(topics.GRID_MAP_UPDATES, patch_to_msg(patch, header))

    def _publish_level(self, T_map_level: FloatArray, stamp_ns: int, frame: str) -> None:
        before = self._T_map_level
        if before is None or not np.allclose(before, T_map_level, atol=1e-6):
            self._T_map_level = T_map_level
            edge = conversions.transform_to_msg(T_map_level, stamp_ns, self._frame, frame)
            self._publish(topics.TF_STATIC, TFMessage(transforms=[edge]))

    def _publish(self, topic: str, message: Any) -> None:
        self._send(Output(topic, serialize_message(message)))
