"""The services of the node: files of the maps, and the objects of the object map."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hoid_msgs.srv import AddToMap, FindObjects, ForgetObject, SaveMap
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import InputError, counted
from hoid_common.ros import conversions
from hoid_common.ros.conversions.slam import keyframe_poses_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.execution.service_handlers import ServiceHandlers
from hoid_common.store.map_directory import CLOUD, GRID, OBJECTS, FileKind, path_in, write_whole
from hoid_scene.config.scene_config import SceneNodeConfig
from hoid_scene.export import write_ply
from hoid_scene.grid.floor import NO_FLOOR
from hoid_scene.grid.grid import write_map_server
from hoid_scene.ros.object_messages import detailed_object_to_msg, mapped_object_to_msg
from hoid_scene.ros.outputs import SceneOutputs
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_session import SceneSession
from hoid_scene.search.object_list import objects_yaml, whereabouts
from hoid_scene.search.object_query import ObjectQuery, find
from hoid_scene.search.rooms import room_name


class SceneServices:
    """Offers the services, which are executed between two messages."""

    def __init__(
        self,
        node: Node,
        config: SceneNodeConfig,
        session: SceneSession,
        outputs: SceneOutputs,
        diagnostics: Diagnostics,
    ) -> None:
        self._config, self._session, self._outputs = config, session, outputs
        handlers = ServiceHandlers(node, diagnostics)
        handlers.add(SaveMap, topics.SAVE_CLOUD, self._save_cloud)
        handlers.add(SaveMap, topics.SAVE_GRID, self._save_grid)
        handlers.add(SaveMap, topics.SAVE_OBJECTS, self._save_objects)
        handlers.add_with_response(FindObjects, topics.FIND_OBJECTS, self._find)
        handlers.add(ForgetObject, topics.FORGET_OBJECT, self._forget)
        handlers.add(AddToMap, topics.ADD_TO_MAP, self._add_to_map)

    def _save_cloud(self, request: SaveMap.Request) -> str:
        mapper, path = self._dense(request, CLOUD)
        cloud = mapper.cloud()
        write_whole(path, lambda aside: write_ply(aside, *cloud))
        return f'{counted(len(cloud.points_m), "point")} written to {path}'

    def _save_grid(self, request: SaveMap.Request) -> str:
        mapper, path = self._dense(request, GRID)
        grid = self._outputs.place_grid(mapper, mapper.cloud())
        if grid is None:
            raise InputError(NO_FLOOR)
        stem = path.with_suffix('')
        write_whole(stem, lambda aside: write_map_server(grid, aside))
        height, width = grid.cells.shape
        return f'{width}x{height} cells written to {stem}.yaml and its picture'

    def _dense(self, request: SaveMap.Request, kind: FileKind) -> tuple[SceneMapper, Path]:
        """Return the scene mapper and the path of a file; InputError without a dense map."""
        path = path_in(self._config.map_directory, request.name, kind)
        if not self._config.dense.enabled:
            raise InputError('the dense map is off here: dense.enabled is false')
        mapper = self._session.mapper
        if mapper is None or len(mapper.dense) == 0:
            raise InputError('no image has been fused yet: there is no dense map to save')
        return mapper, path

    def _save_objects(self, request: SaveMap.Request) -> str:
        path = path_in(self._config.map_directory, request.name, OBJECTS)
        self._require_object_map()
        mapper = self._session.mapper
        objects = () if mapper is None else mapper.mapped_objects()
        text = objects_yaml(objects, self._outputs.frame)
        write_whole(path, lambda aside: aside.write_text(text, encoding='utf-8'))
        return f'{counted(len(objects), "object")} written to {path}'

    def _find(self, request: Any, response: Any) -> str:
        query = query_from_msg(request)
        query.check()
        self._require_object_map()
        mapper = self._session.mapper
        every = () if mapper is None else mapper.mapped_objects(tentative=True)
        # Rooms are computed only if needed, which takes a second in a large map.
        rooms = cache(lambda: None if mapper is None else mapper.rooms(every))
        found = find(every, query, lambda item: room_name(item, rooms()))
        response.header = conversions.header_to_msg(self._session.stamp_ns, self._outputs.frame)
        response.objects = [
            detailed_object_to_msg(item, whereabouts(item, every, rooms()))
            if request.details
            else mapped_object_to_msg(item)
            for item in found
        ]
        return counted(len(found), 'object')

    def _forget(self, request: Any) -> str:
        self._require_object_map()
        mapper = self._session.mapper
        objects = None if mapper is None else mapper.object_map
        if objects is None or not objects.forget(request.id):
            raise InputError(f'no object {request.id} in the object map; find_objects lists them')
        self._outputs.note_object_change()
        return f'object {request.id} is forgotten'

    def _add_to_map(self, request: Any) -> str:
        poses = keyframe_poses_from_msg(request.keyframes)
        return self._session.add_to_map(Path(request.path), poses)

    def _require_object_map(self) -> None:
        if not self._config.object_map.enabled:
            raise InputError(
                'there is no object map: start hoid_scene with object_map.enabled=true'
            )


def query_from_msg(request: Any) -> ObjectQuery:
    """Return the query of a request of hoid_msgs/FindObjects, without checking its values.

    An empty state means objects that are present, and a radius of 0 means objects anywhere.
    """
    state = request.state or FindObjects.Request.PRESENT
    query = ObjectQuery(
        request.class_name,
        state=state,
        moved_since_ns=conversions.stamp_from_msg(request.moved_since) or None,
    )
    if request.radius == 0:
        return query
    near_m = np.array([request.near.x, request.near.y, request.near.z])
    return query._replace(near_map_m=near_m, radius_m=request.radius)
