"""The camera's way from image to image: expected, observed and summed up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.model.trajectory import main_map
from rgbd_slam.optimize.pose_consensus import Consensus
from rgbd_slam.tracking.jitter import Jitter
from rgbd_slam.tracking.motion import ConstantVelocity, MotionSource, WheelMotion

# What a camera may have turned and gone while lost, as standard deviations [rad, m]: of poses in
# a map that nothing has joined with the main one.
_UNKNOWN_COVARIANCE = np.diag(np.square([np.pi] * 3 + [10.0] * 3))


class Bridge(NamedTuple):
    """Where the wheels have taken the camera since it was tracked last."""

    T_map_camera: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6) of a small motion of the camera, rotation first
    image_covariance: FloatArray  # (6, 6) of it, what images in a row do not share
    elapsed_s: float
    way_m: float


class Odometry:
    """Goes from the last tracked frame to the next; its sum never jumps with the map.

    Args:
        atlas: The map, by which the last frame's pose is known at any time.
        wheels: Somebody else's odometry, if there is one.
    """

    def __init__(self, atlas: Atlas, wheels: MotionSource | None = None) -> None:
        self.last: TrackedFrame | None = None
        self.T_odom_camera = np.eye(4)
        self._atlas = atlas
        self._motion = ConstantVelocity()
        self._wheels = WheelMotion(wheels or (lambda *_: None))
        self._T_odom_last = np.eye(4)
        self._is_bridged = False
        self._jitter = Jitter()
        # Of the last frame's pose, (6, 6) of a small motion of the camera, rotation first; and of
        # it, what images in a row do not share.
        self.covariance = self.image_covariance = np.zeros((6, 6))

    def follow(self, stamp_ns: int) -> None:
        """Hear what the wheels say of the time up to an image."""
        self._wheels.follow(stamp_ns)

    def predict(self, stamp_ns: int) -> list[FloatArray]:
        """Return T_camera_last (4, 4) that may be expected, the likeliest first.

        While the camera is tracked its own motion is: wheels slip.
        """
        assert self.last is not None
        own = self._motion.predict(stamp_ns - self.last.frame.stamp_ns)
        T_last_now = self._wheels.T_last_now
        if T_last_now is None:
            return [own]
        both = [own, se3.inverse(T_last_now)]
        return both[::-1] if self._is_bridged else both

    def advance(self, tracked: TrackedFrame, consensus: Consensus) -> None:
        """Take the motion since the last frame, both poses by the map as it is now."""
        assert self.last is not None
        T_last_camera = se3.inverse(self.last.current_pose(self._atlas)) @ tracked.T_map_camera
        elapsed_ns = tracked.frame.stamp_ns - self.last.frame.stamp_ns
        self._motion.observe(se3.inverse(T_last_camera), elapsed_ns)
        self._wheels.compare(T_last_camera)
        if self._is_bridged or elapsed_ns <= 0:
            self._jitter.restart()
        if self._is_bridged:
            self.bridge()  # what was said meanwhile is not taken back
        else:
            self._move(T_last_camera)
        self._jitter.add(tracked.frame.stamp_ns, self.T_odom_camera)
        self._judge(consensus)
        self.restart_from(tracked)

    def bridge(self) -> Bridge | None:
        """Go on by the wheels, with no image; None where they say nothing."""
        T_last_now = self._wheels.T_last_now
        if self.last is None or T_last_now is None:
            return None
        self._is_bridged = True
        self._move(T_last_now)
        A = se3.adjoint(se3.inverse(T_last_now))
        return Bridge(
            self.pose() @ T_last_now,
            A @ self.covariance @ A.T + self._wheels.covariance,
            self._wheels.image_covariance,
            self._wheels.elapsed_s,
            float(np.linalg.norm(T_last_now[:3, 3])),
        )

    def restart_from(self, tracked: TrackedFrame | None) -> None:
        """Take another last frame, or none, without a motion to it."""
        self.last = tracked
        self._T_odom_last, self._is_bridged = self.T_odom_camera, False
        if tracked is not None:
            self._wheels.begin(tracked.frame.stamp_ns)

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

    def _judge(self, consensus: Consensus) -> None:
        """Tell the covariances: by the jitter seen, or by residuals alone until it is known."""
        jitter = self._jitter.covariance(consensus.image_covariance)
        if jitter is None:
            self.covariance = consensus.covariance
            self.image_covariance = consensus.image_covariance
        else:
            self.covariance = jitter + consensus.image_covariance
            self.image_covariance = jitter + consensus.ambiguity

    def _move(self, T_last_now: FloatArray) -> None:
        self.T_odom_camera = se3.orthonormalized(self._T_odom_last @ T_last_now)

    @property
    def twist(self) -> FloatArray:
        """Return (6,) of points in the camera's frame, as last observed: rad/s, then m/s."""
        return self._motion.twist

    @property
    def is_in_main_map(self) -> bool:
        """Return whether the last frame is in the map that most keyframes are in."""
        keyframes = self._atlas.keyframes
        i = keyframes.index_of(self.last.reference_uid) if self.last is not None else None
        return i is None or int(keyframes.map_id[i]) == main_map(keyframes)
