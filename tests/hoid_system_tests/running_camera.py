"""A camera whose clock keeps running while the SLAM node is down, and checkpoints of the node."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np
from hoid_msgs.msg import SlamStatus

from hoid_common import se3
from hoid_common.errors import MapFileError
from hoid_common.ros import conversions
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import FloatArray
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.point_world import CAMERA, PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer, features_msg
from rgbd_slam.store import map_file

_WRITTEN_S = 20.0


def camera_at(i: int) -> FloatArray:
    """Return the (4, 4) pose of the camera at a place of its path."""
    return pose_after(i, turn_rad=0.01)


class RunningCamera(SlamPeer):
    """A camera whose clock keeps running while the node is down."""

    def __init__(self, probe: Probe) -> None:
        super().__init__(probe)
        self.world, self.stamp_ns = PointWorld(3000), START_NS

    def send(self, place: int) -> SlamStatus:
        """Publish the next image, taken at a place, and return its status."""
        self.stamp_ns += PERIOD_NS
        return self.answer_to(features_msg(self.world.features(camera_at(place), self.stamp_ns)))

    def send_all(self, places: Iterable[int]) -> list[SlamStatus]:
        """Publish images taken at places, one after the other, and return the status of each."""
        return [self.send(place) for place in places]

    def await_ready(self) -> None:
        """Publish camera infos, as a driver does, until the node publishes a status."""
        self.status.clear()
        due_s = 0.0

        def has_status() -> bool:
            nonlocal due_s
            if time.monotonic() > due_s:
                due_s = time.monotonic() + 0.1
                header = conversions.header_to_msg(self.stamp_ns + PERIOD_NS, OPTICAL)
                self.camera.publish(conversions.camera_to_msg(CAMERA, header))
            return bool(self.status)

        self.probe.spin_until(has_status, 'the node does not get ready', 60.0)

    def last_pose(self) -> FloatArray:
        """Return the (4, 4) T_map_camera of the last image, from /tf."""
        return self.pose(self.stamp_ns)

    def check_pose(self, place: int) -> None:
        """Check that the last image was taken at a place, within 2 cm and 1 degree."""
        error = se3.log(se3.inverse(T_BODY_OPTICAL @ camera_at(place)) @ self.last_pose())
        assert np.linalg.norm(error[3:]) < 0.02
        assert np.degrees(np.linalg.norm(error[:3])) < 1

    def await_checkpoint(self, folder: Path) -> None:
        """Wait until the node has written a checkpoint into a folder from now on."""
        before_ns = time.time_ns()

        def is_written() -> bool:
            with suppress(MapFileError, OSError, StopIteration):  # it is just being made
                path = next(folder.glob('.running-*.hoidmap'))
                return path.stat().st_ctime_ns > before_ns and bool(map_file.load(path).map)
            return False

        self.probe.spin_until(is_written, 'no checkpoint', _WRITTEN_S)
