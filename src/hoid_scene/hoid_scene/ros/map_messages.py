"""Converts maps to messages: the dense map, the grid, and the masks of Nav2's costmap filters."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import Pose
from map_msgs.msg import OccupancyGridUpdate
from nav2_msgs.msg import CostmapFilterInfo
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import LabelInfo, VisionClass

from hoid_common.ros import conversions
from hoid_common.ros.conversions.arrays import array_field
from hoid_common.ros.large_messages.serialized import cloud_to_cdr
from hoid_common.values import ByteArray, FloatArray
from hoid_scene.dense.cloud_labels import CloudLabels
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.grid import Grid
from hoid_scene.grid.steady_grid import GridPatch
from hoid_scene.navigation_masks import Mask


class FilterType(IntEnum):
    """The kinds of costmap filters (nav2_costmap_2d/costmap_filters/filter_values.hpp)."""

    KEEP_OUT = 0
    SPEED_PERCENT = 1


# Base and multiplier: a cell of the speed mask is the reduction of speed in percent.
_BASES = {FilterType.KEEP_OUT: (0.0, 1.0), FilterType.SPEED_PERCENT: (100.0, -1.0)}


class SceneMaps(NamedTuple):
    """The maps of the scene at one time."""

    cloud: ColoredCloud
    header: Header  # with the map frame
    grid: Grid | None = None  # None: no floor is known, or the grid is not published now
    grid_header: Header | None = None  # with the level frame of the grid, or with the map frame
    grid_height_m: float = 0.0  # z of the grid in the frame of its header
    # The changed cells of the grid; None: no cell has changed, its size, origin or resolution has,
    # or it is the first grid.
    patch: GridPatch | None = None
    # (4, 4) pose of the level frame; None: unchanged, or the grid is in the map frame.
    T_map_level: FloatArray | None = None
    labels: CloudLabels | None = None  # labels of the cloud's points; None: no labels
    is_discarded: bool = False  # True: the scene was discarded, and the maps are empty


def serialized_cloud(maps: SceneMaps) -> ByteArray:
    labels = None if maps.labels is None else maps.labels.labels
    cloud = conversions.Cloud(maps.cloud.points_m, maps.cloud.colors_bgr, labels)
    return cloud_to_cdr(cloud, maps.header)


def labels_to_msg(maps: SceneMaps) -> LabelInfo | None:
    """Return the names of the labels of the cloud; None if it has no labels."""
    if maps.labels is None:
        return None
    classes = [
        VisionClass(class_id=i + 1, class_name=name)
        for i, name in enumerate(maps.labels.class_names)
        if name
    ]
    return LabelInfo(header=maps.header, class_map=classes)


def level_frame_to_msg(maps: SceneMaps) -> TFMessage | None:
    """Return the transform of the level frame; None if it has not changed, or there is none."""
    if maps.T_map_level is None or maps.grid_header is None:
        return None
    stamp_ns = conversions.stamp_from_msg(maps.header.stamp)
    frames = maps.header.frame_id, maps.grid_header.frame_id
    return TFMessage(
        transforms=[conversions.transform_to_msg(maps.T_map_level, stamp_ns, *frames)]
    )


def grid_to_msg(maps: SceneMaps) -> OccupancyGrid | None:
    """Return the message of the whole grid; None if no floor is known."""
    grid, header = maps.grid, maps.grid_header
    if grid is None or header is None:
        return OccupancyGrid(header=maps.header) if maps.is_discarded else None
    origin_m = *grid.origin_m, maps.grid_height_m
    return occupancy_to_msg(grid.cells, grid.resolution_m, origin_m, header)


def occupancy_to_msg(
    cells: NDArray[np.int8], cell_m: float, origin_m: tuple[float, float, float], header: Header
) -> OccupancyGrid:
    height, width = cells.shape
    origin = Pose()  # without rotation: Nav2 ignores it
    origin.position.x, origin.position.y, origin.position.z = origin_m
    info = MapMetaData(
        map_load_time=header.stamp, resolution=cell_m, width=width, height=height, origin=origin
    )
    return OccupancyGrid(header=header, info=info, data=array_field('b', cells))


def grid_update_to_msg(maps: SceneMaps) -> OccupancyGridUpdate | None:
    """Return the message of the changed part of the grid."""
    patch = maps.patch
    if patch is None:
        return None
    height, width = patch.cells.shape
    return OccupancyGridUpdate(
        header=maps.grid_header,
        x=patch.column,
        y=patch.row,
        width=width,
        height=height,
        data=array_field('b', patch.cells),
    )


def mask_to_msg(mask: Mask, header: Header) -> OccupancyGrid:
    (x, y), _, cell_m = mask.extent
    return occupancy_to_msg(mask.cells, cell_m, (x * cell_m, y * cell_m, 0.0), header)


def filter_info_to_msg(kind: FilterType, mask_topic: str, header: Header) -> CostmapFilterInfo:
    """Return the message with the topic of a mask and the scale of its values, for Nav2.

    Args:
        mask_topic: Full name of the topic of the mask: Nav2's nodes have namespaces of their own.
    """
    base, multiplier = _BASES[kind]
    return CostmapFilterInfo(
        header=header,
        type=int(kind),
        filter_mask_topic=mask_topic,
        base=base,
        multiplier=multiplier,
    )
