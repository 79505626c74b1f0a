"""The camera's way from image to image: expected, observed and summed up."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.model.trajectory import main_map
from rgbd_slam.tracking.motion import ConstantVelocity

# What a camera may have turned and gone while lost, as standard deviations [rad, m]: of poses in
# a map that nothing has joined with the main one.
_UNKNOWN_COVARIANCE = np.diag(np.square([np.pi] * 3 + [10.0] * 3))


class Odometry:
    """Goes from the last tracked frame to the next; its sum never jumps with the map.

    Args:
        atlas: The map, by which the last frame's pose is known at any time.
    """

    def __init__(self, atlas: Atlas) -> None:
        self.last: TrackedFrame | None = None
        self.T_odom_camera = np.eye(4)
        self._atlas = atlas
        self._motion = ConstantVelocity()

    def predict(self, stamp_ns: int) -> FloatArray:
        """Return T_camera_last (4, 4), the motion expected since the last frame."""
        assert self.last is not None
        return self._motion.predict(stamp_ns - self.last.frame.stamp_ns)

    def advance(self, tracked: TrackedFrame) -> None:
        """Take the motion since the last frame, both poses by the map as it is now."""
        assert self.last is not None
        T_last_camera = se3.inverse(self.last.current_pose(self._atlas)) @ tracked.T_map_camera
        elapsed_ns = tracked.frame.stamp_ns - self.last.frame.stamp_ns
        self._motion.observe(se3.inverse(T_last_camera), elapsed_ns)
        self.T_odom_camera = se3.orthonormalized(self.T_odom_camera @ T_last_camera)
        self.last = tracked

    def go_on_from(self, tracked: TrackedFrame | None) -> None:
        """Take another last frame, or none, without a motion to it."""
        self.last = tracked

    def stop(self) -> None:
        """Expect no motion, until one is observed."""
        self._motion.forget()

    def redirect(self, redirects: Iterable[Redirect]) -> None:
        """Hang the last frame on what took the place of removed keyframes."""
        if self.last is not None:
            self.last = self.last.redirected(redirects)

    def pose(self) -> FloatArray:
        """Return T_map_camera (4, 4) of the last frame as the map says now; without one, I."""
        return np.eye(4) if self.last is None else self.last.current_pose(self._atlas)

    def in_map(self, covariance: FloatArray) -> FloatArray:
        """Return how well the last pose is known (6, 6): not where its map lies, unless main."""
        return covariance if self.is_in_main_map else covariance + _UNKNOWN_COVARIANCE

    @property
    def is_in_main_map(self) -> bool:
        """Return whether the last frame is in the map that most keyframes are in."""
        keyframes = self._atlas.keyframes
        i = keyframes.index_of(self.last.reference_uid) if self.last is not None else None
        return i is None or int(keyframes.map_id[i]) == main_map(keyframes)
