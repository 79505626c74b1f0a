"""From the camera's poses in the core's map to the frames of a robot (REP 103, REP 105).

The core's map frame is the first camera's optical frame. A robot's map is level with its base,
z up. Without a base frame, the camera is taken to be level when it starts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray, Trajectory
from rgbd_slam.model.keyframe_poses import KeyframePoses

T_BODY_OPTICAL: FloatArray = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Optical (x right, y down, z forward) to body (x forward, y left, z up), REP 103."""

# Of a velocity that nothing tells, as standard deviations [rad/s, m/s].
_UNKNOWN_TWIST = np.diag(np.square([np.pi] * 3 + [10.0] * 3))
_MAX_TWIST_GAP_S = 0.5  # over a longer silence, the mean motion says little of the velocity


@dataclass(frozen=True, eq=False)
class RobotPose:
    """Where the base is: the two edges of the frame tree, and how it moves."""

    T_map_odom: FloatArray  # (4, 4); jumps when the map is corrected
    T_odom_base: FloatArray  # (4, 4); never jumps
    covariance: FloatArray  # (6, 6) of a small motion in the base frame, rotation first
    twist: FloatArray  # (6,) in the base frame: rad/s, then m/s
    twist_covariance: FloatArray  # (6, 6) of it


class _Placed(NamedTuple):
    stamp_ns: int
    T_odom_base: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6) in the base frame, of what this image errs by alone


class RobotFrames:
    """Places the robot's base from the camera's poses.

    Args:
        T_base_camera: (4, 4) where the camera's optical frame sits on the robot; None when no base
            is known, and the camera's optical frame then stands for it.
        planar: Whether the base moves in the plane z = 0 only and does not tilt.
    """

    def __init__(self, T_base_camera: FloatArray | None = None, *, planar: bool = False) -> None:
        self.T_map_core = T_BODY_OPTICAL if T_base_camera is None else T_base_camera
        self._T_camera_base = np.eye(4) if T_base_camera is None else se3.inverse(T_base_camera)
        self._planar = planar and T_base_camera is not None
        self._last: _Placed | None = None

    def place(
        self,
        stamp_ns: int,
        T_map_camera: FloatArray,
        T_odom_camera: FloatArray,
        covariance: FloatArray,
        image_covariance: FloatArray | None = None,
    ) -> RobotPose:
        """Return the robot's pose from the core's, whose covariance is of the camera's frame.

        Args:
            stamp_ns: Of the image.
            T_map_camera: (4, 4) in the core's map.
            T_odom_camera: (4, 4) without the map's jumps.
            covariance: (6, 6) of a small motion of the camera.
            image_covariance: (6, 6) of it, what images in a row do not share; all by default.
        """
        T_map_base = self._base(T_map_camera)
        T_odom_base = self._base(T_odom_camera)
        A = se3.adjoint(se3.inverse(self._T_camera_base))
        own = covariance if image_covariance is None else image_covariance
        placed = _Placed(stamp_ns, T_odom_base, A @ own @ A.T)
        pose = RobotPose(
            T_map_base @ se3.inverse(T_odom_base),
            T_odom_base,
            A @ covariance @ A.T,
            *self._twist(placed),
        )
        self._last = placed
        return pose

    def camera_at(self, T_map_base: FloatArray) -> FloatArray:
        """Return T_core_camera (4, 4) for a pose that was given of the base, x forward, z up.

        Without a base, that is taken of the camera's body.
        """
        return se3.inverse(self.T_map_core) @ T_map_base @ self.T_map_core

    def camera_motion(self, T_base_base: FloatArray) -> FloatArray:
        """Return the camera's motion (4, 4) between two times, for the base's."""
        return self._T_camera_base @ T_base_base @ se3.inverse(self._T_camera_base)

    def bases(self, cameras: Trajectory) -> Trajectory:
        """Return the base's poses in the map for the camera's in the core's map."""
        return Trajectory(
            cameras.stamps_ns, self.T_map_core @ cameras.T_world_camera @ self._T_camera_base
        )

    def cameras(self, cameras: Trajectory) -> Trajectory:
        """Return the camera's poses in the map for those in the core's map."""
        return Trajectory(cameras.stamps_ns, self.T_map_core @ cameras.T_world_camera)

    def keyframes(self, poses: KeyframePoses) -> KeyframePoses:
        """Return keyframes' poses in the map for those in the core's map."""
        return poses._replace(T_map_camera=self.T_map_core @ poses.T_map_camera)

    def points_m(self, points_core_m: FloatArray) -> FloatArray:
        """Return (N, 3) points of the core's map in the robot's."""
        return se3.transform(self.T_map_core, points_core_m)

    def _base(self, T_core_camera: FloatArray) -> FloatArray:
        T = self.T_map_core @ T_core_camera @ self._T_camera_base
        return flattened(T) if self._planar else T

    def _twist(self, now: _Placed) -> tuple[FloatArray, FloatArray]:
        """Return the mean velocity since the last pose, and its covariance."""
        last = self._last
        elapsed_s = 0.0 if last is None else (now.stamp_ns - last.stamp_ns) / NS_PER_S
        if last is None or not 0 < elapsed_s <= _MAX_TWIST_GAP_S:
            return np.zeros(6), _UNKNOWN_TWIST
        T_last_now = se3.inverse(last.T_odom_base) @ now.T_odom_base
        A = se3.adjoint(se3.inverse(T_last_now))
        covariance = now.covariance + A @ last.covariance @ A.T
        return se3.log(T_last_now) / elapsed_s, covariance / elapsed_s**2


def flattened(T: FloatArray) -> FloatArray:
    """Return (4, 4) with x, y and yaw only."""
    yaw = np.arctan2(T[1, 0], T[0, 0])
    twist = np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.0])
    out = se3.exp(twist)
    out[:2, 3] = T[:2, 3]
    return out
