"""Leveling of the map frame by gravity, whose direction becomes more accurate with time."""

from __future__ import annotations

import numpy as np

from hoid_common.slam_status import SlamState
from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.inertial.gravity import Gravity
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.tracking.tracking_result import TrackingResult

# Chosen: a measured direction of gravity with a larger standard deviation is not used. It is far
# below the 20 degrees within which floors are found.
_MAX_SIGMA_RAD = np.deg2rad(3.0)
# Chosen: the map frame is not turned any more once the standard deviation is below this, or this
# time after the first usable measurement, so that goals and saved places stay valid.
_LEVEL_SIGMA_RAD, _LEVEL_AFTER_NS = np.deg2rad(0.5), 30 * NS_PER_S


class Leveling:
    """Turns the map frame with each new measurement of gravity, so that its z axis points up.

    If the first trial of the accelerometer fails, the initial map frame is restored. The frame
    stays fixed once gravity is accurate, or 30 s after the first usable measurement.
    """

    def __init__(self, frames: RobotFrames, imu: Imu | None) -> None:
        self._frames, self._imu = frames, imu
        self._last: Gravity | None = None
        # (3,) z axis of the initial map frame, in the first camera's frame; None unless an
        # accelerometer that is not tried yet has turned the map frame.
        self._up_untried: FloatArray | None = None
        self._first_ns: int | None = None

    def update(self, result: TrackingResult, *, is_in_main_map: bool) -> bool:
        """Turn the map frame if gravity was measured at this image; return whether it was turned.

        Only the main map is leveled. Once its frame is fixed, the IMU stops measuring gravity.
        """
        imu, frames = self._imu, self._frames
        if imu is None:
            return False
        imu.levels = imu.levels and not frames.is_fixed
        if frames.is_fixed or not is_in_main_map:
            return False
        if imu.trust.agrees is False:
            return self._restore_start()
        up = imu.confirmed_up
        if up is None or up is self._last or up.sigma_rad > _MAX_SIGMA_RAD:
            return False
        is_tracked = result.state is SlamState.TRACKING and result.T_map_camera is not None
        if not is_tracked or up.stamp_ns != result.stamp_ns:
            return False
        return self._level(imu, up, result)

    def _level(self, imu: Imu, up: Gravity, result: TrackingResult) -> bool:
        frames = self._frames
        assert result.T_map_camera is not None
        self._last = up
        if imu.trust.agrees:
            self._up_untried = None
        elif self._first_ns is None:
            self._up_untried = frames.T_map_core[2, :3].copy()
        turned_rad = frames.level(result.T_map_camera[:3, :3] @ up.up_camera)
        first_ns = self._first_ns = self._first_ns or result.stamp_ns
        is_old = result.stamp_ns - first_ns > _LEVEL_AFTER_NS
        is_known = up.sigma_rad < _LEVEL_SIGMA_RAD and imu.trust.agrees is not None
        frames.is_fixed = is_old or is_known
        frames.is_level |= is_known
        return turned_rad > 0

    def _restore_start(self) -> bool:
        """Restore the initial map frame, unless a trial of the accelerometer has succeeded."""
        if self._up_untried is None:
            return False
        up, self._up_untried, self._first_ns = self._up_untried, None, None
        return self._frames.level(up) > 0
