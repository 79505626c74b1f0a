"""The services that find, forget and export objects of the object map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hoid_msgs.srv import FindObjects, ForgetObject, SaveMap

from hoid_common import topics
from hoid_common.ros import conversions
from hoid_scene.objects.object_query import ObjectQuery
from rgbd_slam.ros.scene.client import SceneClient
from rgbd_slam.ros.scene.messages import SceneCommand
from rgbd_slam.ros.scene.object_map_messages import mapped_object_to_msg
from rgbd_slam.ros.service_handlers import ServiceHandlers
from rgbd_slam.store.map_directory import OBJECTS, FileKind


class ObjectServices:
    """Offers the services of the object map.

    Args:
        handlers: Handlers that run in a thread that may wait for the scene process.
        scene: Client of the scene process, which has the object map.
        map_frame: Name of the map frame.
        new_path: Returns the path of a file to write, from its name in a request and its kind.
    """

    def __init__(
        self,
        handlers: ServiceHandlers,
        scene: SceneClient,
        map_frame: str,
        new_path: Callable[[str, FileKind], Path],
    ) -> None:
        self._scene, self._frame, self._new_path = scene, map_frame, new_path
        handlers.add_with_response(FindObjects, topics.FIND_OBJECTS, self._find)
        handlers.add(ForgetObject, topics.FORGET_OBJECT, self._forget)
        handlers.add(SaveMap, topics.SAVE_OBJECTS, self._save)

    def _find(self, request: Any, response: Any) -> str:
        query = query_from_msg(request)
        query.check()
        result = self._scene.ask_objects(SceneCommand(query=query))
        response.header = conversions.header_to_msg(result.stamp_ns, self._frame)
        response.objects = [mapped_object_to_msg(item) for item in result.objects]
        return f'{len(result.objects)} objects'

    def _forget(self, request: Any) -> str:
        return self._scene.ask_objects(SceneCommand(forget_id=request.id)).text

    def _save(self, request: Any) -> str:
        path = self._new_path(request.name, OBJECTS)
        return self._scene.ask_objects(SceneCommand(yaml_path=path)).text


def query_from_msg(request: Any) -> ObjectQuery:
    """Return the query of a request of hoid_msgs/FindObjects, without checking its values.

    An empty state means objects that are present, and a radius of 0 means objects anywhere.
    """
    state = request.state or FindObjects.Request.PRESENT
    if request.radius == 0:
        return ObjectQuery(request.class_name, state=state)
    near_m = np.array([request.near.x, request.near.y, request.near.z])
    return ObjectQuery(request.class_name, near_m, request.radius, state)
