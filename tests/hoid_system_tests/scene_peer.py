"""A peer of rgbd_slam and hoid_scene, which also publishes the images that the scene needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from hoid_msgs.msg import DynamicObjectArray, SlamStatus
from hoid_msgs.srv import SaveMap
from sensor_msgs.msg import Image, PointCloud2

from hoid_bringup.live.supervisor import Supervisor
from hoid_common.ros import conversions, qos
from hoid_common.values import FloatArray
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.rendered_room import Messages
from hoid_system_tests.slam_peer import SlamPeer

RELIABLE = {'input.reliability': 'reliable', 'input.queue_length': 100}
"""Parameters with which no image is lost on a busy machine."""
_MAP_S = 30.0  # limit for the first dense map
_CAMERA_S, _MAPPER_S = 0.03, 0.5  # pauses: the period of a camera, and for a busy mapper


class SceneNodes(NamedTuple):
    """The two nodes that map a scene."""

    slam: Supervisor
    scene: Supervisor


def start_scene(
    start: Start,
    scene: Mapping[str, Any] | None = None,
    slam: Mapping[str, Any] | None = None,
    **both: Any,
) -> SceneNodes:
    """Start rgbd_slam and hoid_scene with reliable inputs.

    Args:
        start: Starts a node.
        scene: Parameters of hoid_scene.
        slam: Parameters of rgbd_slam.
        both: Parameters of both.
    """
    return SceneNodes(
        start('rgbd_slam', 'rgbd_slam_node', RELIABLE | both | dict(slam or {})),
        start('hoid_scene', 'hoid_scene_node', RELIABLE | both | dict(scene or {})),
    )


class ScenePeer(SlamPeer):
    """Publishes a rendered recording image by image."""

    def __init__(self, probe: Probe) -> None:
        self.clouds = probe.collect(PointCloud2, 'cloud_map', qos.LATCHED, wait=False)
        super().__init__(probe)
        self.depth = probe.publisher(Image, 'depth/image')
        self.color = probe.publisher(Image, 'rgb/image')
        self.objects = probe.publisher(DynamicObjectArray, 'dynamic_objects')

    def save(self, name: str = '', what: str = 'map') -> Any:
        """Call `~/save_map` of rgbd_slam, or `~/save_cloud` ... of hoid_scene."""
        node = 'rgbd_slam' if what == 'map' else 'hoid_scene'
        return self.probe.call(SaveMap, f'{node}/save_{what}', SaveMap.Request(name=name))

    def show(self, image: Messages) -> SlamStatus:
        """Publish all messages of an image and return its status."""
        self.depth.publish(image.depth)
        self.color.publish(image.color)
        self.objects.publish(image.objects)
        return self.answer_to(image.features)

    def play(self, images: Iterable[Messages]) -> list[SlamStatus]:
        """Publish images one by one, no faster than a camera, and return the status of each.

        While the mapper is behind, the next image waits longer, so that a busy machine makes the
        same map.
        """
        answers = []
        for image in images:
            answers.append(self.show(image))
            self.probe.spin_for(_MAPPER_S if answers[-1].mapper_queue else _CAMERA_S)
        return answers

    def cloud_m(self) -> FloatArray:
        """Wait for a dense map that is not empty, and return the newest one's points (N, 3)."""
        self.probe.spin_until(
            lambda: bool(self.clouds and self.clouds[-1].width), 'no dense map', _MAP_S
        )
        return conversions.cloud_from_msg(self.clouds[-1]).points_m.astype(np.float64)
