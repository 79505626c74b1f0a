"""All topics of the scene: four tables of topics, and the class that publishes them.

A topic is added as one row of a table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from hoid_msgs.msg import DetectionArray, TrackedObjectArray
from map_msgs.msg import OccupancyGridUpdate
from nav2_msgs.msg import CostmapFilterInfo
from nav_msgs.msg import OccupancyGrid
from people_msgs.msg import People
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3DArray, LabelInfo
from visualization_msgs.msg import MarkerArray

from hoid_common import topics
from hoid_common.ros import qos
from hoid_common.ros.conversions import detections_to_msg, header_to_msg
from hoid_common.values import Detections, FloatArray
from hoid_scene.config.scene_config import SceneConfig
from hoid_scene.dense.cloud_labels import CloudLabels
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.grid import Grid
from hoid_scene.grid.steady_grid import GridPatch, SteadyGrid
from hoid_scene.navigation_masks import Mask, NavigationMasks, changed_cells
from hoid_scene.ros import map_messages
from hoid_scene.ros import object_messages as of_objects
from hoid_scene.ros.map_messages import FilterType, SceneMaps, filter_info_to_msg, mask_to_msg
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.tracks.object_track import TrackedObject


class OutputTopic(NamedTuple):
    """A topic, and the function that returns its message or the bytes of the serialized message.

    The function returns None if nothing is to be published.
    """

    name: str
    type: Any
    qos: QoSProfile
    to_msg: Callable[..., Any]


# `to_msg` is called with (objects: tuple[TrackedObject, ...], header: Header) after each image
# that is used to track objects, if the topic has subscribers. When a scene is discarded after an
# image, it is called for this table and the next two even without subscribers, with empty values.
OBJECT_OUTPUTS = (
    OutputTopic(
        topics.TRACKED_OBJECTS,
        TrackedObjectArray,
        qos.OUTPUT,
        of_objects.tracked_objects_to_msg,
    ),
    OutputTopic(topics.PEOPLE, People, qos.OUTPUT, of_objects.people_to_msg),
    OutputTopic(
        topics.TRACKED_OBJECT_MARKERS,
        MarkerArray,
        qos.OUTPUT,
        of_objects.track_markers_to_msg,
    ),
)
# `to_msg` is called with (objects: tuple[MapObject, ...], header: Header) if the topic has
# subscribers: after each image that is used for the object map, and after other changes of the map
# once per `dense.publish_period_s`, or when subscribers join or leave.
OBJECT_MAP_OUTPUTS = (
    OutputTopic(topics.OBJECT_MAP, Detection3DArray, qos.LATCHED, of_objects.object_map_to_msg),
    OutputTopic(
        topics.OBJECT_MAP_MARKERS,
        MarkerArray,
        qos.LATCHED,
        of_objects.object_map_markers_to_msg,
    ),
)
# `to_msg` is called with (expected: Detections, header: Header, image_size_px: tuple[int, int])
# after each image that is used for the object map, if the topic has subscribers.
EXPECTED_OUTPUT = OutputTopic(
    topics.EXPECTED_OBJECTS, DetectionArray, qos.OUTPUT, detections_to_msg
)
# `to_msg` is called with (maps: SceneMaps) once per `dense.publish_period_s`, or when subscribers
# join or leave, if the maps have changed and a topic of the table has subscribers. The cloud and
# its labels are computed only if they have subscribers themselves; all other messages are computed
# if any of them has subscribers. After each publication, a pause keeps time for images.
MAP_OUTPUTS = (
    OutputTopic(topics.CLOUD_MAP, PointCloud2, qos.LATCHED, map_messages.serialized_cloud),
    OutputTopic(topics.CLOUD_LABELS, LabelInfo, qos.LATCHED, map_messages.labels_to_msg),
    OutputTopic(topics.TF_STATIC, TFMessage, qos.TF_STATIC, map_messages.level_frame_to_msg),
    OutputTopic(topics.GRID_MAP, OccupancyGrid, qos.LATCHED, map_messages.grid_to_msg),
    OutputTopic(
        topics.GRID_MAP_UPDATES, OccupancyGridUpdate, qos.OUTPUT, map_messages.grid_update_to_msg
    ),
)


# `to_msg` is called with (mask: Mask, header: Header) whenever a mask has changed, at most once in
# `NavigationConfig.period_s`, and with a mask of 0 when the scene ends.
MASK_OUTPUTS = (
    OutputTopic(topics.KEEP_OUT_MASK, OccupancyGrid, qos.LATCHED, mask_to_msg),
    OutputTopic(topics.SPEED_MASK, OccupancyGrid, qos.LATCHED, mask_to_msg),
)
# `to_msg` is called with (mask_topic: str, header: Header) once, before the first mask: Nav2
# subscribes to the mask anew with each message.
MASK_INFO_OUTPUTS = (
    OutputTopic(
        topics.KEEP_OUT_INFO,
        CostmapFilterInfo,
        qos.LATCHED,
        partial(filter_info_to_msg, FilterType.KEEP_OUT),
    ),
    OutputTopic(
        topics.SPEED_INFO,
        CostmapFilterInfo,
        qos.LATCHED,
        partial(filter_info_to_msg, FilterType.SPEED_PERCENT),
    ),
)
_OF_MASKS = frozenset(output.name for output in (*MASK_OUTPUTS, *MASK_INFO_OUTPUTS))
_OF_CLOUD = frozenset({topics.CLOUD_MAP, topics.CLOUD_LABELS})


class Publisher(Protocol):
    """A publisher that knows whether somebody subscribes (`OnDemandPublisher`)."""

    @property
    def is_wanted(self) -> bool:
        """Return whether the topic has subscribers."""

    def publish(self, message: Any) -> None:
        """Publish a message or a serialized message (N,) uint8."""


class SceneOutputs:
    """Publishes the scene in the map frame, with the stamp of the latest image in it.

    If the map frame is not level, the grid is in a separate frame, `<map frame>_level`.

    Attributes:
        frame: Name of the map frame.
    """

    def __init__(
        self, make_publisher: Callable[[OutputTopic], Publisher], config: SceneConfig
    ) -> None:
        tables = (*MAP_OUTPUTS, *OBJECT_OUTPUTS, *OBJECT_MAP_OUTPUTS, EXPECTED_OUTPUT)
        masks = (*MASK_OUTPUTS, *MASK_INFO_OUTPUTS) if config.navigation.enabled else ()
        left_out = {
            topics.CLOUD_LABELS: not config.object_map.label_cloud,
            topics.EXPECTED_OBJECTS: config.object_map.prior_score == 0,
        }
        self._publishers = {
            output.name: make_publisher(output)
            for output in (*tables, *masks)
            if not left_out.get(output.name, False)
        }
        self.frame, self._is_map_level = '', False
        self._steady = SteadyGrid()
        self._T_map_level: FloatArray | None = None  # last published pose
        # Topics of `MAP_OUTPUTS` and of `OBJECT_MAP_OUTPUTS` whose last message is not up to date.
        self._outdated: set[str] = set()
        self._outdated_objects: set[str] = set()
        self._has_published = False  # whether anything was published since the scene was discarded
        self._masks: dict[str, Mask] = {}  # last published masks, by topic

    def set_level(self, *, is_map_level: bool) -> None:
        """Set whether the map frame is level; if this changes, the grid has another frame."""
        if is_map_level != self._is_map_level:
            self._is_map_level = is_map_level
            self._steady.clear()

    @property
    def _wanted(self) -> set[str]:
        """Return the topics that have subscribers.

        /tf_static is left out, because its subscribers need not be interested in the scene.
        """
        wanted = {name for name, publisher in self._publishers.items() if publisher.is_wanted}
        return wanted - {topics.TF_STATIC}

    def note_change(self) -> None:
        self._outdated = {o.name for o in MAP_OUTPUTS if o.name in self._publishers}
        if self._is_map_level:
            self._outdated.discard(topics.TF_STATIC)
        self.note_object_change()

    def note_object_change(self) -> None:
        self._outdated_objects = {output.name for output in OBJECT_MAP_OUTPUTS}

    @property
    def due(self) -> frozenset[str]:
        """Return the topics of `MAP_OUTPUTS` that are outdated and whose messages are wanted.

        The cloud and its labels are wanted if they have subscribers. Each other message is wanted
        if any other topic has subscribers.
        """
        wanted = self._outdated & self._wanted
        if wanted - _OF_CLOUD or self._wanted & _OF_MASKS:
            wanted |= self._outdated - _OF_CLOUD
        return frozenset(wanted)

    def publish_objects(self, objects: tuple[TrackedObject, ...], stamp_ns: int) -> None:
        """Publish the tracks after an image with this stamp, on topics that have subscribers."""
        self._publish_wanted(OBJECT_OUTPUTS, objects, header_to_msg(stamp_ns, self.frame))

    def publish_masks(
        self, masks: NavigationMasks, stamp_ns: int, resolve: Callable[[str], str]
    ) -> None:
        """Publish the masks for navigation that have changed, with the cells of the last grid.

        Nothing is published before the first grid, and on topics without subscribers. Nav2 applies
        a keep-out mask only where the costmap is updated. Where the mask has changed, the grid is
        therefore published again as an update, so that closed cells can open.
        """
        grid = self._steady.last
        if grid is None or not self._is_map_level:
            return
        header, extent = header_to_msg(stamp_ns, self.frame), grid.extent
        for output, info, mask_of in zip(
            MASK_OUTPUTS, MASK_INFO_OUTPUTS, (masks.keep_out, masks.speed), strict=True
        ):
            if not self._wanted & {output.name, info.name}:
                continue
            mask, before = mask_of(extent), self._masks.get(output.name)
            if before is None:
                self._publish([info], resolve(output.name), header)
            elif before.extent == extent and np.array_equal(before.cells, mask.cells):
                continue
            self._masks[output.name] = mask
            self._publish([output], mask, header)
            if output.name == topics.KEEP_OUT_MASK:
                self._publish_update(grid, changed_cells(before, mask), header)

    def _publish_update(self, grid: Grid, patch: GridPatch | None, header: Header) -> None:
        if patch is None:
            return
        rows, columns = patch.cells.shape
        top, left = patch.row, patch.column
        patch = patch._replace(cells=grid.cells[top : top + rows, left : left + columns])
        empty = ColoredCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
        maps = SceneMaps(empty, header, grid, header, patch=patch)
        self._publish([o for o in MAP_OUTPUTS if o.name == topics.GRID_MAP_UPDATES], maps)

    def publish_object_map(self, scene: SceneMapper, stamp_ns: int) -> None:
        due = self._outdated_objects & self._wanted
        wanted = [output for output in OBJECT_MAP_OUTPUTS if output.name in due]
        if wanted:
            self._outdated_objects -= {output.name for output in wanted}
            header = header_to_msg(stamp_ns, self.frame)
            self._publish(wanted, scene.mapped_objects(), header)

    def publish_expected(
        self, expected: Detections, header: Header, image_size_px: tuple[int, int]
    ) -> None:
        """Publish the expected boxes of known objects in an image, if the topic is subscribed."""
        self._publish_wanted((EXPECTED_OUTPUT,), expected, header, image_size_px)

    def publish_map(self, scene: SceneMapper, stamp_ns: int) -> None:
        due = self.due
        self._outdated -= due
        header, cloud = header_to_msg(stamp_ns, self.frame), scene.cloud()
        grid = self.place_grid(scene, cloud) if due - _OF_CLOUD else None
        if grid is None:
            maps = SceneMaps(cloud, header)
        elif self._is_map_level:
            patch = self._steady.take_patch(grid)
            maps = SceneMaps(cloud, header, grid, header, float(grid.T_map_origin[2, 3]), patch)
        else:
            level_header = header_to_msg(stamp_ns, f'{self.frame}_level')
            patch, T_map_level = self._steady.take_patch(grid), self._take_level(grid.T_map_level)
            maps = SceneMaps(cloud, header, grid, level_header, 0.0, patch, T_map_level)
        if due & _OF_CLOUD:
            maps = maps._replace(labels=scene.label(cloud))
        self._publish([output for output in MAP_OUTPUTS if output.name in due], maps)

    def place_grid(self, scene: SceneMapper, cloud: ColoredCloud) -> Grid | None:
        """Return the grid of a cloud of the scene, with the size in which it is published."""
        grid = scene.grid(cloud)
        return None if grid is None else self._steady.place(grid)

    def clear(self, stamp_ns: int) -> None:
        """Publish empty maps and no tracks, because the scene was discarded."""
        self._outdated.clear()
        self._outdated_objects.clear()
        if not self._has_published:
            return
        self._clear_masks(stamp_ns)
        self._steady.clear()
        empty = ColoredCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
        header = header_to_msg(stamp_ns, self.frame)
        # Late subscribers must not get a map that was discarded.
        is_labeled = topics.CLOUD_LABELS in self._publishers
        labels = CloudLabels(np.empty(0, np.uint32), ()) if is_labeled else None
        self._publish(MAP_OUTPUTS, SceneMaps(empty, header, labels=labels, is_discarded=True))
        self._publish(OBJECT_OUTPUTS, (), header)
        self._publish(OBJECT_MAP_OUTPUTS, (), header)
        self._has_published = False

    def _clear_masks(self, stamp_ns: int) -> None:
        for output in MASK_OUTPUTS:
            if (mask := self._masks.get(output.name)) is not None:
                empty = Mask(np.zeros_like(mask.cells), mask.extent)
                self._masks[output.name] = empty
                self._publish([output], empty, header_to_msg(stamp_ns, self.frame))

    def _take_level(self, T_map_level: FloatArray) -> FloatArray | None:
        """Return the pose (4, 4) of the level frame, or None if it was published already."""
        before = self._T_map_level
        if before is not None and np.allclose(before, T_map_level, atol=1e-6):
            return None
        self._T_map_level = T_map_level
        return T_map_level

    def _publish_wanted(self, outputs: Sequence[OutputTopic], *source: object) -> None:
        wanted = self._wanted
        self._publish([output for output in outputs if output.name in wanted], *source)

    def _publish(self, outputs: Sequence[OutputTopic], *source: object) -> None:
        for output in outputs:
            message = output.to_msg(*source)
            publisher = self._publishers.get(output.name)
            if message is not None and publisher is not None:
                publisher.publish(message)
                self._has_published = True
