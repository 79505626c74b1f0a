"""A peer of rgbd_slam that gives it whole images, for the maps of the room."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from hoid_msgs.msg import DynamicObjectArray, SlamStatus
from sensor_msgs.msg import Image, PointCloud2

from hoid_common.ros import conversions, qos
from hoid_common.values import FloatArray
from hoid_system_tests.probe import Probe
from hoid_system_tests.rendered_room import Messages
from hoid_system_tests.slam_peer import SlamPeer

RELIABLE = {'input.reliability': 'reliable', 'input.queue_length': 100}
"""Parameters with which no image is lost on a busy machine."""
_MAP_S = 30.0
_CAMERA_S, _MAPPER_S = 0.03, 0.5  # pauses


class RoomPeer(SlamPeer):
    """Shows the node a rendered recording, image by image."""

    def __init__(self, probe: Probe) -> None:
        self.clouds = probe.collect(PointCloud2, 'cloud_map', qos.LATCHED, wait=False)
        super().__init__(probe)
        self.depth = probe.publisher(Image, 'depth/image')
        self.color = probe.publisher(Image, 'rgb/image')
        self.objects = probe.publisher(DynamicObjectArray, 'dynamic_objects')

    def show(self, image: Messages) -> SlamStatus:
        """Send all of an image and return what is said of it."""
        self.depth.publish(image.depth)
        self.color.publish(image.color)
        self.objects.publish(image.objects)
        return self.answer_to(image.features)

    def play(self, images: Iterable[Messages]) -> list[SlamStatus]:
        """Show images one by one and return what is said of each.

        A camera is slower than this could be, and the mapper must keep up to map as well as with
        one, also on a busy machine.
        """
        answers = []
        for image in images:
            answers.append(self.show(image))
            self.probe.spin_for(_MAPPER_S if answers[-1].mapper_queue else _CAMERA_S)
        return answers

    def cloud_m(self) -> FloatArray:
        """Return the (N, 3) points of the newest dense map, once one is not empty."""
        self.probe.spin_until(
            lambda: bool(self.clouds and self.clouds[-1].width), 'no dense map', _MAP_S
        )
        return conversions.cloud_from_msg(self.clouds[-1]).points_m.astype(np.float64)
