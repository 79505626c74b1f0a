"""From the camera's poses in the core's map to the frames of a robot (REP 103, REP 105).

The core's map frame is the first camera's optical frame. A robot's map is level with its base,
z up. Without a base frame, the camera is taken to be level when it starts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray, Trajectory
from rgbd_slam.model.keyframe_poses import KeyframePoses

T_BODY_OPTICAL: FloatArray = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Optical (x right, y down, z forward) to body (x forward, y left, z up), REP 103."""

_MAX_TWIST_GAP_S = 0.5  # over a longer silence, the mean motion says little of the velocity


@dataclass(frozen=True, eq=False)
class RobotPose:
    """Where the base is: the two edges of the frame tree, and how it moves."""

    T_map_odom: FloatArray  # (4, 4); jumps when the map is corrected
    T_odom_base: FloatArray  # (4, 4); never jumps
    covariance: FloatArray  # (6, 6) of a small motion in the base frame, rotation first
    twist: FloatArray  # (6,) in the base frame: rad/s, then m/s


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
        self._last: tuple[int, FloatArray] | None = None

    def place(
        self,
        stamp_ns: int,
        T_map_camera: FloatArray,
        T_odom_camera: FloatArray,
        covariance: FloatArray,
    ) -> RobotPose:
        """Return the robot's pose from the core's, whose covariance is of the camera's frame."""
        T_map_base = self._base(T_map_camera)
        T_odom_base = self._base(T_odom_camera)
        A = adjoint(se3.inverse(self._T_camera_base))
        pose = RobotPose(
            T_map_base @ se3.inverse(T_odom_base),
            T_odom_base,
            A @ covariance @ A.T,
            self._twist(stamp_ns, T_odom_base),
        )
        self._last = stamp_ns, T_odom_base
        return pose

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

    def _twist(self, stamp_ns: int, T_odom_base: FloatArray) -> FloatArray:
        if self._last is None:
            return np.zeros(6)
        elapsed_s = (stamp_ns - self._last[0]) / NS_PER_S
        if not 0 < elapsed_s <= _MAX_TWIST_GAP_S:
            return np.zeros(6)
        return se3.log(se3.inverse(self._last[1]) @ T_odom_base) / elapsed_s


def adjoint(T_a_b: FloatArray) -> FloatArray:
    """Return (6, 6) that turns small motions, rotation first, of frame b into those of frame a."""
    R = T_a_b[:3, :3]
    A = np.zeros((6, 6))
    A[:3, :3] = A[3:, 3:] = R
    A[3:, :3] = se3.hat(T_a_b[:3, 3]) @ R
    return A


def flattened(T: FloatArray) -> FloatArray:
    """Return (4, 4) with x, y and yaw only."""
    yaw = np.arctan2(T[1, 0], T[0, 0])
    twist = np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.0])
    out = se3.exp(twist)
    out[:2, 3] = T[:2, 3]
    return out
