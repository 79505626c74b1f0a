"""The services of the node: files of the maps, and the objects of the object map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hoid_msgs.srv import AddToMap, FindObjects, ForgetObject, SaveMap
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.ros import conversions
from hoid_common.ros.conversions.slam import keyframe_poses_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.execution.service_handlers import ServiceHandlers
from hoid_common.store.map_directory import CLOUD, GRID, OBJECTS, FileKind, path_in
from hoid_scene.config.scene_config import SceneNodeConfig
from hoid_scene.objects.object_list import ObjectQuery, find
from hoid_scene.ros.files import save_cloud, save_grid, save_objects
from hoid_scene.ros.object_messages import mapped_object_to_msg
from hoid_scene.ros.outputs import SceneOutputs
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_session import SceneSession


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
        handlers.add(SaveMap, topics.SAVE_CLOUD, self._of_dense(CLOUD, save_cloud))
        handlers.add(SaveMap, topics.SAVE_GRID, self._of_dense(GRID, self._save_grid))
        handlers.add(SaveMap, topics.SAVE_OBJECTS, self._save_objects)
        handlers.add_with_response(FindObjects, topics.FIND_OBJECTS, self._find)
        handlers.add(ForgetObject, topics.FORGET_OBJECT, self._forget)
        handlers.add(AddToMap, topics.ADD_TO_MAP, self._add_to_map)

    def _of_dense(
        self, kind: FileKind, save: Callable[[SceneMapper | None, Path], str]
    ) -> Callable[[SaveMap.Request], str]:
        def handle(request: SaveMap.Request) -> str:
            path = path_in(self._config.map_directory, request.name, kind)
            if not self._config.dense.enabled:
                raise InputError('the dense map is off here: dense.enabled is false')
            return save(self._session.mapper, path)

        return handle

    def _save_grid(self, mapper: SceneMapper | None, path: Path) -> str:
        return save_grid(mapper, self._outputs.place_grid, path)

    def _save_objects(self, request: SaveMap.Request) -> str:
        path = path_in(self._config.map_directory, request.name, OBJECTS)
        self._require_object_map()
        return save_objects(self._session.mapper, path, self._outputs.frame)

    def _find(self, request: Any, response: Any) -> str:
        query = query_from_msg(request)
        query.check()
        self._require_object_map()
        mapper = self._session.mapper
        found = [] if mapper is None else find(mapper.mapped_objects(tentative=True), query)
        response.header = conversions.header_to_msg(self._session.stamp_ns, self._outputs.frame)
        response.objects = [mapped_object_to_msg(item) for item in found]
        return f'{len(found)} objects'

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
            raise InputError('the object map is off here: object_map.enabled is false')


def query_from_msg(request: Any) -> ObjectQuery:
    """Return the query of a request of hoid_msgs/FindObjects, without checking its values.

    An empty state means objects that are present, and a radius of 0 means objects anywhere.
    """
    state = request.state or FindObjects.Request.PRESENT
    if request.radius == 0:
        return ObjectQuery(request.class_name, state=state)
    near_m = np.array([request.near.x, request.near.y, request.near.z])
    return ObjectQuery(request.class_name, near_m, request.radius, state)
