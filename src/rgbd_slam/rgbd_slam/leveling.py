"""Makes the map frame level by gravity, while the direction of gravity becomes better known."""

from __future__ import annotations

import numpy as np

from hoid_common.slam_status import SlamState
from hoid_common.values import NS_PER_S
from rgbd_slam.inertial.imu import Imu, Up
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.tracking.tracking_result import TrackingResult

_MAX_SIGMA_RAD = np.deg2rad(3.0)  # chosen: far below the 20 degrees within which floors are found
# Chosen: the map frame is kept from then on, so that goals and saved places stay valid.
_LEVEL_SIGMA_RAD, _LEVEL_AFTER_NS = np.deg2rad(0.5), 30 * NS_PER_S


class Leveling:
    """Turns the map frame with each new measurement of gravity, for the first 30 s.

    Args:
        frames: The frames.
        imu: The IMU; None: the map frame stays as the start gives it.
    """

    def __init__(self, frames: RobotFrames, imu: Imu | None) -> None:
        self._frames, self._imu = frames, imu
        self._last: Up | None = None
        self._first_ns: int | None = None

    def update(self, result: TrackingResult, *, is_in_main_map: bool) -> bool:
        """Return whether the map frame was turned after an image.

        Args:
            result: The pose of the image.
            is_in_main_map: Whether it is a pose in the main map.
        """
        if self._imu is None:
            return False
        if self._frames.is_fixed:
            self._imu.stop_measuring_up()
        up = self._imu.up
        if up is None or up is self._last or self._frames.is_fixed:
            return False
        is_tracked = result.state is SlamState.TRACKING and result.T_map_camera is not None
        if not is_tracked or not is_in_main_map or up.stamp_ns != result.stamp_ns:
            return False
        self._last = up
        if up.sigma_rad > _MAX_SIGMA_RAD:
            return False
        assert result.T_map_camera is not None
        turned_rad = self._frames.level(result.T_map_camera[:3, :3] @ up.up_camera)
        first_ns = self._first_ns = self._first_ns or result.stamp_ns
        is_old = result.stamp_ns - first_ns > _LEVEL_AFTER_NS
        self._frames.is_fixed = is_old or up.sigma_rad < _LEVEL_SIGMA_RAD
        return turned_rad > 0
