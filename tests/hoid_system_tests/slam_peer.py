"""Peer of rgbd_slam: publishes a camera and features, and collects the outputs."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import SlamStatus
from hoid_msgs.srv import LoadMap, SaveMap, SetMode
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from hoid_common.ros import conversions, qos
from hoid_common.values import Features, FloatArray
from hoid_system_tests.frame_tree import OPTICAL, edges
from hoid_system_tests.point_world import CAMERA
from hoid_system_tests.probe import Probe

START_NS, PERIOD_NS = 1_305_031_102_175_304_123, 33_333_333
_READY_S = 60.0  # the node starts processes
_RESEND_S = 3.0


def features_msg(features: Features) -> FeaturesMsg:
    """Return the message of features that the camera of a point world sees."""
    header = conversions.header_to_msg(features.stamp_ns, OPTICAL)
    size_px = (CAMERA.width_px, CAMERA.height_px)
    return conversions.features_to_msg(features, header, size_px)


class SlamPeer:
    """Publishes the features of images, each after the status of the previous one."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        every = qos.profile(1000, latched=True)
        self.status = probe.collect(SlamStatus, 'slam_status', every, wait=False)
        self.tf = probe.collect(TFMessage, '/tf', qos.TF, wait=False)
        self.diagnostics = probe.collect(DiagnosticArray, '/diagnostics', wait=False)
        self.camera = probe.publisher(CameraInfo, 'rgb/camera_info')
        self.features = probe.publisher(FeaturesMsg, 'features')

    def send_camera(self, msg: CameraInfo | None = None) -> None:
        """Publish a camera info; by default that of a point world."""
        header = conversions.header_to_msg(START_NS, OPTICAL)
        self.camera.publish(msg or conversions.camera_to_msg(CAMERA, header))

    def begin(self, msg: CameraInfo | None = None) -> None:
        """Publish the camera info repeatedly, as a driver does, until the node is ready."""
        due_s = 0.0

        def is_ready() -> bool:
            nonlocal due_s
            if not self.status and time.monotonic() > due_s:
                due_s = time.monotonic() + _RESEND_S
                self.send_camera(msg)
            return bool(self.status)

        self.probe.spin_until(is_ready, 'the node does not get ready', _READY_S)

    def answer_to(self, features: FeaturesMsg) -> SlamStatus:
        """Publish the features of an image and return its status."""
        before = len(self.status)
        self.features.publish(features)
        self.probe.spin_until(lambda: len(self.status) > before, 'no slam_status')
        return self.status[-1]

    def tree(self, stamp_ns: int) -> dict[tuple[str, str], FloatArray]:
        """Return the transforms of an image by parent and child frame, once both are there."""
        self.probe.spin_until(lambda: len(edges(self.tf, stamp_ns)) == 2, 'no transforms')
        return edges(self.tf, stamp_ns)

    def pose(self, stamp_ns: int) -> FloatArray:
        """Return the (4, 4) T_map_camera of an image, from /tf."""
        tree = self.tree(stamp_ns)
        return np.asarray(tree['map', 'odom'] @ tree['odom', OPTICAL])

    def save(self, name: str = '', what: str = 'map') -> Any:
        """Call `~/save_map` or `~/save_trajectory`."""
        return self.probe.call(SaveMap, f'rgbd_slam/save_{what}', SaveMap.Request(name=name))

    def load(self, name: str = '', *, merge: bool = False) -> Any:
        """Call `~/load_map`."""
        request = LoadMap.Request(name=name, merge=merge)
        return self.probe.call(LoadMap, 'rgbd_slam/load_map', request)

    def set_mode(self, mode: str) -> Any:
        """Call `~/set_mode`."""
        return self.probe.call(SetMode, 'rgbd_slam/set_mode', SetMode.Request(mode=mode))

    def diagnosis(self, node: str = '/rgbd_slam') -> tuple[str, dict[str, str]]:
        """Return message and values of a node's next diagnostics."""

        def of_node() -> list[DiagnosticStatus]:
            return [s for d in self.diagnostics for s in d.status if s.name == node]

        self.diagnostics.clear()
        self.probe.spin_until(lambda: bool(of_node()), f'no diagnostics of {node}')
        status = of_node()[-1]
        return status.message, {v.key: v.value for v in status.values}

    def wait_for_count(self, name: str, number: int) -> None:
        """Wait until a counter of the diagnostics of /rgbd_slam has this value."""
        self.probe.spin_until(
            lambda: self.diagnosis()[1].get(name) == str(number),
            f'"{name}" does not become {number}',
        )
