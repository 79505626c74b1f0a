"""A client that asks the scene node, if it runs, to add its maps to a map file."""

from __future__ import annotations

from pathlib import Path
from threading import Event

from hoid_msgs.msg import KeyframePoses
from hoid_msgs.srv import AddToMap
from rclpy.node import Node

from hoid_common import topics

_SCENE = 'hoid_scene'  # name of the scene node, in the namespace of this node
# Chosen: more than the time to rebuild the dense map, which the scene node may first have to do.
_LIMIT_S = 20.0


class SceneMapClient:
    """Client of the service `add_to_map` of the scene node."""

    def __init__(self, node: Node) -> None:
        service = topics.ADD_TO_MAP.replace('~', _SCENE)
        self._client = node.create_client(AddToMap, service)

    def add_to(self, path: Path, keyframes: KeyframePoses) -> str:
        """Ask the scene node to add its maps to a closed map file; return a phrase for logs.

        Do not call this in the node's thread. A map is complete without a scene.
        """
        if not self._client.service_is_ready():
            return f'without a dense map, as {_SCENE} does not run,'
        done = Event()
        future = self._client.call_async(AddToMap.Request(path=str(path), keyframes=keyframes))
        future.add_done_callback(lambda _: done.set())
        if not done.wait(_LIMIT_S):
            self._client.remove_pending_request(future)
            return f'without a dense map, as {_SCENE} has not answered in {_LIMIT_S:g} s,'
        response = future.result()
        if response is None or not response.success:
            reason = 'no response' if response is None else response.message
            return f'without a dense map ({_SCENE}: {reason})'
        return f'with {response.message}'
