"""Converts the scene to messages: dense map, grid, tracked objects, people and markers."""

from __future__ import annotations

from array import array
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import Point, Pose
from hoid_msgs.msg import TrackedObject as TrackedObjectMsg
from hoid_msgs.msg import TrackedObjectArray
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from people_msgs.msg import People, Person
from std_msgs.msg import ColorRGBA, Header
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import LabelInfo, VisionClass
from visualization_msgs.msg import MarkerArray

from hoid_common.ros import conversions
from hoid_common.ros.large_messages.serialized import cloud_to_cdr
from hoid_common.values import ByteArray, FloatArray, ObjectState
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.grid import Grid
from hoid_scene.grid.steady_grid import GridPatch
from hoid_scene.objects.cloud_labels import CloudLabels
from hoid_scene.ros.markers import LabeledBox, markers_of, vector_to_msg
from hoid_scene.tracks.object_tracker import TrackedObject

_COLORS = {
    ObjectState.PERSON: ColorRGBA(r=0.9, g=0.2, b=0.2, a=0.5),
    ObjectState.HANDLED: ColorRGBA(r=1.0, g=0.6, b=0.1, a=0.7),
    ObjectState.AT_REST: ColorRGBA(r=0.5, g=0.5, b=0.5, a=0.3),
    ObjectState.MOVED: ColorRGBA(r=0.2, g=0.6, b=1.0, a=0.7),
    ObjectState.MOVING: ColorRGBA(r=0.9, g=0.9, b=0.0, a=0.5),
}


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
    labels: CloudLabels | None = None  # of the points of the cloud; None: they have no labels
    is_discarded: bool = False  # True: the scene was discarded, and the maps are empty


def serialized_cloud(maps: SceneMaps) -> ByteArray:
    """Return the serialized sensor_msgs/PointCloud2 of the dense map."""
    labels = None if maps.labels is None else maps.labels.labels
    cloud = conversions.Cloud(maps.cloud.points_m, maps.cloud.colors_bgr, labels)
    return cloud_to_cdr(cloud, maps.header)


def labels_to_msg(maps: SceneMaps) -> LabelInfo | None:
    """Return the names of the labels of the cloud; None if it has no labels.

    The label 0 of points without an object has no name.
    """
    if maps.labels is None:
        return None
    classes = [
        VisionClass(class_id=i + 1, class_name=name)
        for i, name in enumerate(maps.labels.class_names)
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
    """Return the message of the whole grid; None if no floor is known.

    For a scene that was discarded, it is an empty grid.
    """
    grid, header = maps.grid, maps.grid_header
    if grid is None or header is None:
        return OccupancyGrid(header=maps.header) if maps.is_discarded else None
    origin_m = *grid.origin_m, maps.grid_height_m
    return occupancy_to_msg(grid.cells, grid.resolution_m, origin_m, header)


def occupancy_to_msg(
    cells: NDArray[np.int8], cell_m: float, origin_m: tuple[float, float, float], header: Header
) -> OccupancyGrid:
    """Return the message of the cells (H, W) of a grid.

    Args:
        cells: The values; row 0 is at the smallest y.
        cell_m: Width of a cell.
        origin_m: Position of the corner of cell (0, 0) in the frame of the header.
        header: Frame and stamp.
    """
    height, width = cells.shape
    origin = Pose()  # without rotation: Nav2 ignores it
    origin.position.x, origin.position.y, origin.position.z = origin_m
    info = MapMetaData(
        map_load_time=header.stamp, resolution=cell_m, width=width, height=height, origin=origin
    )
    return OccupancyGrid(header=header, info=info, data=array('b', cells.tobytes()))


def grid_update_to_msg(maps: SceneMaps) -> OccupancyGridUpdate | None:
    """Return the message of the changed part of the grid.

    None is returned if there is no patch; see `SceneMaps.patch`.
    """
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
        data=array('b', patch.cells.tobytes()),
    )


def tracked_objects_to_msg(
    objects: tuple[TrackedObject, ...], header: Header
) -> TrackedObjectArray:
    """Return the message of the tracks, in the frame of the header."""
    return TrackedObjectArray(header=header, objects=[_object_to_msg(item) for item in objects])


def people_to_msg(objects: tuple[TrackedObject, ...], header: Header) -> People:
    """Return the message of the tracked people, in the frame of the header."""
    people = [_person_to_msg(item) for item in objects if item.state is ObjectState.PERSON]
    return People(header=header, people=people)


def markers_to_msg(objects: tuple[TrackedObject, ...], header: Header) -> MarkerArray:
    """Return markers that replace all earlier ones: a box and a label per object."""
    return markers_of([_labeled_box(item) for item in objects], header)


def _object_to_msg(item: TrackedObject) -> TrackedObjectMsg:
    return TrackedObjectMsg(
        id=item.track_id,
        class_name=item.class_name,
        state=item.state.value,
        score=float(item.score),
        position=_point(item),
        velocity=vector_to_msg(item.velocity_map_mps),
        size=vector_to_msg(item.size_m),
    )


def _person_to_msg(item: TrackedObject) -> Person:
    x, y, z = item.velocity_map_mps.tolist()
    return Person(
        name=str(item.track_id),
        position=_point(item),
        velocity=Point(x=x, y=y, z=z),
        reliability=float(item.score),
    )


def _labeled_box(item: TrackedObject) -> LabeledBox:
    text = f'{item.class_name} {item.track_id}: {item.state.name.lower()}'
    pose = Pose(position=_point(item))
    return LabeledBox(item.track_id, pose, item.size_m, text, _COLORS[item.state])


def _point(item: TrackedObject) -> Point:
    x, y, z = item.position_map_m.tolist()
    return Point(x=x, y=y, z=z)
