"""Conversion of camera poses in the core's map to poses of a robot (REP 103, REP 105).

The robot's map frame has z up and is level with the base at the start, or it is the frame of a
saved map. Without a base frame, the camera is assumed to be level at the start, until an
accelerometer has measured gravity (`RobotFrames.level`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import NS_PER_S, FloatArray, Trajectory

# Covariance of an unknown velocity. Chosen: standard deviations of half a turn per second and 10
# m/s, more than the speed of any hand-held camera or indoor robot.
_UNKNOWN_TWIST = np.diag(np.square([np.pi] * 3 + [10.0] * 3))
# Least covariance of a pose. Chosen: standard deviations of 1 mrad and 1 mm. The covariance of the
# first pose is zero, because it defines the map, but in a message zeros mean "unknown"
# (nav_msgs/Odometry).
_LEAST_COVARIANCE = 1e-6 * np.eye(6)
_UP: FloatArray = np.array([0.0, 0.0, 1.0])
_LEAST_SINE = 1e-9  # chosen: angles with a smaller sine count as zero
# Chosen, as in `TrackingStates`: the mean motion over a longer gap hardly depends on the velocity.
_MAX_TWIST_GAP_S = 0.5


def camera_mount(roll_deg: float, pitch_deg: float, yaw_deg: float) -> FloatArray:
    """Return T_base_camera (4, 4) of a camera that is mounted rotated on a level base.

    Roll is about the viewing direction, clockwise as seen from behind; pitch is down, yaw left.
    """
    roll, pitch, yaw = np.deg2rad([roll_deg, pitch_deg, yaw_deg])
    turns = (
        se3.exp(np.array([*axis, 0, 0, 0])) for axis in ((0, 0, yaw), (0, pitch, 0), (roll, 0, 0))
    )
    return np.asarray(next(turns) @ next(turns) @ next(turns) @ T_BODY_OPTICAL)


@dataclass(frozen=True, eq=False)
class RobotPose:
    """The pose of the base as the two edges of the frame tree, and its velocity."""

    T_map_odom: FloatArray  # (4, 4); jumps if the map is corrected, as by a loop
    T_odom_base: FloatArray  # (4, 4); never jumps
    # (6, 6) covariance of T_map_base as a small motion in the base frame, rotation first (rad^2,
    # m^2).
    covariance: FloatArray
    twist: FloatArray  # (6,) velocity of the base in the base frame, rotation first (rad/s, m/s)
    twist_covariance: FloatArray  # (6, 6) in rad^2/s^2, m^2/s^2; large if the velocity is unknown


class _BasePose(NamedTuple):
    stamp_ns: int
    T_odom_base: FloatArray  # (4, 4)
    # (6, 6) in the base frame, rotation first: the part whose errors are independent between
    # images.
    covariance: FloatArray


class RobotFrames:
    """Converts camera poses of the core to poses of the robot's base.

    T_base_camera (4, 4) is the pose of the camera's optical frame on the robot. Without a base
    frame (None), the optical frame is the base. A `planar` base moves only in the plane z = 0 and
    does not tilt.
    """

    def __init__(self, T_base_camera: FloatArray | None = None, *, planar: bool = False) -> None:
        self.T_map_core = T_BODY_OPTICAL if T_base_camera is None else T_base_camera
        # The initial map frame, by the mounting of the camera; never changes.
        self._T_odom_core = self.T_map_core
        # True: the map frame is that of a saved map, or stays level, so that `level` does nothing.
        self.is_fixed = False
        # Whether z of the map frame points up, according to the camera's mounting or gravity.
        self.is_level = self._has_base = T_base_camera is not None
        self.T_camera_base = np.eye(4) if T_base_camera is None else se3.inverse(T_base_camera)
        self._planar = planar and T_base_camera is not None
        self._last: _BasePose | None = None

    def robot_pose(
        self,
        stamp_ns: int,
        T_map_camera: FloatArray,
        T_odom_camera: FloatArray,
        covariance: FloatArray,
        image_covariance: FloatArray | None = None,
    ) -> RobotPose:
        """Return pose and velocity of the robot's base for a camera pose of the core.

        The velocity is the mean since the last call; if it is unknown, it is zero with a large
        covariance.

        Args:
            stamp_ns: Stamp of the image.
            T_map_camera: (4, 4) pose in the core's map.
            T_odom_camera: (4, 4) pose in the core's odometry frame, the optical frame of the
                camera in the first tracked image. Corrections of the map do not change it.
            covariance: (6, 6) of T_map_camera (rad^2, m^2), in the camera frame, rotation first.
            image_covariance: (6, 6) part of it whose errors differ from image to image, which
                determines the covariance of the velocity. None: the whole covariance.
        """
        T_map_base = self._base(self.T_map_core @ T_map_camera)
        T_odom_base = self._base(self._T_odom_core @ T_odom_camera)
        A = se3.adjoint(se3.inverse(self.T_camera_base))
        covariance = _known(covariance)
        own = covariance if image_covariance is None else _known(image_covariance)
        placed = _BasePose(stamp_ns, T_odom_base, A @ own @ A.T)
        pose = RobotPose(
            T_map_base @ se3.inverse(T_odom_base),
            T_odom_base,
            A @ covariance @ A.T,
            *self._twist(placed),
        )
        self._last = placed
        return pose

    def camera_at(self, T_map_base: FloatArray) -> FloatArray:
        """Return T_core_camera (4, 4) of a robot with T_map_base (4, 4), x forward and z up."""
        return se3.inverse(self.T_map_core) @ T_map_base @ self._T_odom_core

    def camera_motion(self, T_base_base: FloatArray) -> FloatArray:
        return self.T_camera_base @ T_base_base @ se3.inverse(self.T_camera_base)

    def cameras(self, cameras: Trajectory) -> Trajectory:
        return Trajectory(cameras.stamps_ns, self.T_map_core @ cameras.T_world_camera)

    def take_saved(self) -> None:
        """Fix the map frame, because it is now that of a saved map, which may not be level."""
        self.is_fixed, self.is_level = True, self._has_base

    def level(self, up_core: FloatArray) -> float:
        """Turn the map frame so that z points along `up_core` (3,); return the angle (rad).

        The map frame turns about its origin by the least angle, so that headings are kept. The
        odometry frame does not turn: map -> odom jumps, odom -> base never does. If `is_fixed`, or
        if the base is planar, nothing happens, and the angle is 0.
        """
        if self.is_fixed or self._planar:
            return 0.0
        T = np.eye(4)
        T[:3, :3] = _least_rotation(self._T_odom_core[:3, :3] @ up_core)
        T_before, self.T_map_core = self.T_map_core, T @ self._T_odom_core
        return float(np.linalg.norm(se3.log(se3.inverse(T_before) @ self.T_map_core)[:3]))

    def _base(self, T_world_camera: FloatArray) -> FloatArray:
        T = T_world_camera @ self.T_camera_base
        return flattened(T) if self._planar else T

    def _twist(self, now: _BasePose) -> tuple[FloatArray, FloatArray]:
        """Return the base's mean velocity (6,) since the last pose, and its covariance (6, 6)."""
        last = self._last
        elapsed_s = 0.0 if last is None else (now.stamp_ns - last.stamp_ns) / NS_PER_S
        if last is None or not 0 < elapsed_s <= _MAX_TWIST_GAP_S:
            return np.zeros(6), _UNKNOWN_TWIST
        T_last_now = se3.inverse(last.T_odom_base) @ now.T_odom_base
        A = se3.adjoint(se3.inverse(T_last_now))
        covariance = now.covariance + A @ last.covariance @ A.T
        return se3.log(T_last_now) / elapsed_s, covariance / elapsed_s**2


def _least_rotation(up: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) by the least angle that maps a unit vector (3,) to the z axis."""
    axis = np.cross(up, _UP)
    sine, cosine = float(np.linalg.norm(axis)), float(up @ _UP)
    if sine < _LEAST_SINE:  # upright: no rotation; upside down: half a turn about x
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    twist = np.append(np.arctan2(sine, cosine) / sine * axis, np.zeros(3))
    return np.asarray(se3.exp(twist)[:3, :3])


def _known(covariance: FloatArray) -> FloatArray:
    """Return a covariance (6, 6); zero, which would mean unknown, is replaced by a small one."""
    return covariance if covariance.any() else _LEAST_COVARIANCE


def flattened(T: FloatArray) -> FloatArray:
    """Return the pose (4, 4) with z, roll and pitch set to zero; x, y and yaw are kept."""
    yaw = np.arctan2(T[1, 0], T[0, 0])
    twist = np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.0])
    out = se3.exp(twist)
    out[:2, 3] = T[:2, 3]
    return out
