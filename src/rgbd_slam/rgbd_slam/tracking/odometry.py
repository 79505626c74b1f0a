"""The motion of the camera between frames: predicted, measured and accumulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray, IntArray
from rgbd_slam.config.slam_config import TrackingConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.model.trajectory import main_map
from rgbd_slam.optimize.pose_optimizer import UNKNOWN_COVARIANCE, PosePrior
from rgbd_slam.tracking.inertial_motion import InertialMotion
from rgbd_slam.tracking.motion_sources import BridgedMotion, MotionSource
from rgbd_slam.tracking.pose_noise import LastingNoise, PoseNoise
from rgbd_slam.tracking.rolling_shutter import MovingView
from rgbd_slam.tracking.tracker import TrackerOutput

# Chosen: number of inliers that suffices for a pose that agrees with the gyro's prediction; other
# poses need `TrackingConfig.min_inliers`. It agrees if its rotation differs by less than
# _AGREED_RAD, and its position by less than _AGREED_M plus _AGREED_SIGMAS standard deviations of
# the prediction.
_FEW_INLIERS, _AGREED_RAD, _AGREED_M, _AGREED_SIGMAS = 12, np.deg2rad(1.5), 0.02, 3.0
# Chosen: a prediction over a longer time (s) does not make few inliers more certain, because it
# may be wrong itself, and a few chance matches agree with any pose.
_AGREED_S = 0.2
# Not tuned: longest time for which the last velocity is extrapolated (decision 006); a hand-held
# camera hardly keeps its velocity for longer.
_HORIZON_S = 0.25
# Chosen: time after a bridge in which poses inherit its covariance. Motions over a second, which
# are made of two poses of the odometry, would contain it unseen.
_INHERITED_S = 1.0
_NOTE = 'too few map points are seen; the pose follows {}, for {:.1f} s and {:.2f} m'


class Bridge(NamedTuple):
    """The pose of an image that was not tracked, from external odometry or the gyro."""

    T_map_camera: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6) in the camera frame, rotation first [rad^2, m^2]
    # (6, 6) part of `covariance` whose errors are independent between images.
    image_covariance: FloatArray
    note: str  # text for the status
    T_last_camera: FloatArray  # (4, 4) motion since the last tracked frame
    is_short: bool  # whether the pose is recorded in the trajectory; see `BridgedMotion`


class Odometry:
    """Accumulates the motions between tracked frames, as the pose `T_odom_camera`.

    Corrections of the map do not change this pose. Motion sources predict the motion to the next
    image: a gyro first, then the last velocity, then other sources. While the camera is lost,
    those that measure motion (the gyro for up to 1.5 s) replace the tracker, which is called
    bridging.
    """

    def __init__(
        self,
        atlas: Atlas,
        gyro: InertialMotion | None = None,
        further_sources: Sequence[MotionSource] = (),
    ) -> None:
        self.last: TrackedFrame | None = None
        self.T_odom_camera = np.eye(4)
        # (6,) last tracked velocity of points in the camera frame, rotation first (rad/s, m/s)
        self.twist: FloatArray = np.zeros(6)
        # (6, 6) covariance of T_map_camera of the last frame as a small motion in the camera
        # frame, rotation first (rad^2, m^2), and the part of it whose errors are independent
        # between images.
        self.covariance = self.image_covariance = np.zeros((6, 6))
        self._own_covariance = self.covariance  # without lasting errors and those of a bridge
        self._atlas = atlas
        self._gyro = gyro
        self._sources: list[MotionSource] = [] if gyro is None else [gyro]
        self._sources += further_sources
        self._elapsed_s = 0.0  # time over which `twist` was tracked
        self._stamp_ns = 0  # stamp of the latest image, set by `follow`
        self._T_odom_last = self.T_odom_camera
        self._pose_noise, self._lasting_noise = PoseNoise(), LastingNoise()
        # Stamp of the last bridged image, and (6, 6) covariance of the motion up to it.
        self._bridged_ns, self._bridged_covariance = 0, np.zeros((6, 6))

    def follow(self, stamp_ns: int) -> None:
        self._stamp_ns = stamp_ns
        for source in self._sources:
            source.advance(stamp_ns)

    def twist_at(self, stamp_ns: int) -> FloatArray:
        """Return the velocity (6,) of points in the camera frame at an image, rotation first.

        What no gyro measures is taken from `twist`, the last tracked velocity (rad/s, m/s).
        """
        return self._with_rate(self.twist, stamp_ns)

    def twist_by(self, T_last_camera: FloatArray, stamp_ns: int) -> FloatArray:
        """Return the velocity (6,) as `twist_at` does, after the motion T_last_camera (4, 4).

        It is extrapolated by half an interval from the mean velocities of the last two motions.
        """
        last_ns = stamp_ns if self.last is None else self.last.frame.stamp_ns
        elapsed_s = S_PER_NS * (stamp_ns - last_ns)
        if elapsed_s <= 0:
            return self.twist_at(stamp_ns)
        twist = se3.log(se3.inverse(T_last_camera)) / elapsed_s
        if self.twist.any():
            twist += elapsed_s / (elapsed_s + self._elapsed_s) * (twist - self.twist)
        return self._with_rate(twist, stamp_ns)

    def moving_view(self, exposed: Frame, matched: IntArray) -> MovingView:
        rate_radps = self._rate_radps(exposed.stamp_ns)
        return MovingView(exposed, matched, self.T_odom_camera, rate_radps)

    def _with_rate(self, twist: FloatArray, stamp_ns: int) -> FloatArray:
        rate_radps = self._rate_radps(stamp_ns)
        return twist if rate_radps is None else np.append(-rate_radps, twist[3:])

    def _rate_radps(self, stamp_ns: int) -> FloatArray | None:
        return None if self._gyro is None else self._gyro.rate_radps(stamp_ns)

    def predict(self) -> list[FloatArray]:
        """Return the predicted motions T_camera_last (4, 4), the most reliable first.

        While the camera is tracked, its last velocity is more reliable than wheels, which slip.
        While it is lost, sources that have measured its motion come first.
        """
        sources: list[MotionSource | None] = [*self._sources]
        sources.insert(0 if self._gyro is None else 1, None)  # None: the last velocity
        if self._is_bridged:
            sources.sort(key=lambda source: source is None or source.bridge() is None)
        last_ns = self._stamp_ns if self.last is None else self.last.frame.stamp_ns
        elapsed_s = S_PER_NS * (self._stamp_ns - last_ns)
        T_by_velocity = se3.exp(min(max(elapsed_s, 0.0), _HORIZON_S) * self.twist)
        predictions = (T_by_velocity if s is None else s.predict() for s in sources)
        return [T for T in predictions if T is not None and self._is_valid(T)]

    def prior(self) -> PosePrior | None:
        rotation = None if self._gyro is None else self._gyro.rotation_prior()
        if rotation is None or self.last is None:
            return None
        T_last_camera, information = np.eye(4), np.zeros((6, 6))
        T_last_camera[:3, :3] = rotation.R_first_second
        information[:3, :3] = np.eye(3) / rotation.sigma_rad**2
        return PosePrior(se3.inverse(self.pose() @ T_last_camera), information)

    def min_inliers(self, T_camera_map: FloatArray) -> int:
        """Return the number of inliers that a pose T_camera_map (4, 4) of this image needs.

        If the pose agrees with the gyro's motion since a recent frame, its inliers are hardly
        chance matches, so that few suffice.
        """
        motion = None if self._gyro is None else self._gyro.bridge()
        if motion is None or self.last is None or motion.elapsed_s > _AGREED_S:
            return TrackingConfig.min_inliers
        error = se3.log(T_camera_map @ self.pose() @ motion.T_last_camera)
        sigma_m = float(np.sqrt(np.trace(motion.covariance[3:, 3:])))
        is_same_turn = float(np.linalg.norm(error[:3])) < _AGREED_RAD
        is_near = float(np.linalg.norm(error[3:])) < _AGREED_M + _AGREED_SIGMAS * sigma_m
        return _FEW_INLIERS if is_same_turn and is_near else TrackingConfig.min_inliers

    def advance(self, tracking: TrackerOutput) -> None:
        """Add the motion from the last frame to a newly tracked one, by the current map.

        After bridged images, the motion of the source is added instead, because their published
        poses are not corrected. Velocity and covariances are updated too.
        """
        assert self.last is not None
        tracked = tracking.tracked
        T_last_camera = se3.inverse(self.last.current_pose(self._atlas)) @ tracked.T_map_camera
        elapsed_ns = tracked.frame.stamp_ns - self.last.frame.stamp_ns
        self._observe(T_last_camera, elapsed_ns)
        is_bridged = self._is_bridged
        if is_bridged or elapsed_ns <= 0:
            self._pose_noise.restart()
        if is_bridged:
            self.bridge()  # poses that were published while bridging are not corrected
        else:
            self._move(T_last_camera)
        self._pose_noise.add(tracked.frame.stamp_ns, self.T_odom_camera)
        self._update_covariances(tracking, T_last_camera)
        self.restart_from(tracked)

    def bridge(self) -> Bridge | None:
        """Move `T_odom_camera` to this image by a measured motion; return the image's pose.

        The motion is that of external odometry or the gyro since the last tracked frame. Without a
        last frame or a measured motion, nothing moves, and the result is None.
        """
        motion = self._bridged_motion()
        if self.last is None or motion is None:
            return None
        self._move(motion.T_last_camera)
        self._bridged_ns, self._bridged_covariance = self._stamp_ns, motion.covariance
        A = se3.adjoint(se3.inverse(motion.T_last_camera))
        return Bridge(
            self.pose() @ motion.T_last_camera,
            A @ self.covariance @ A.T + motion.covariance,
            motion.image_covariance,
            _NOTE.format(
                motion.source, motion.elapsed_s, np.linalg.norm(motion.T_last_camera[:3, 3])
            ),
            motion.T_last_camera,
            motion.is_short,
        )

    def extrapolated(self, stamp_ns: int, T_last_camera: FloatArray) -> TrackedFrame:
        """Return the last frame moved by T_last_camera (4, 4), for an image without tracking."""
        last = self.last
        assert last is not None
        return replace(
            last,
            frame=replace(last.frame, stamp_ns=stamp_ns),
            T_map_camera=self.pose() @ T_last_camera,
            T_reference_camera=last.T_reference_camera @ T_last_camera,
        )

    def restart_from(self, tracked: TrackedFrame | None) -> None:
        """Set the last frame (None: there is none) without moving `T_odom_camera`."""
        self.last = tracked
        self._T_odom_last = self.T_odom_camera
        if tracked is not None:
            for source in self._sources:
                source.start(tracked.frame.stamp_ns)

    def forget_velocity(self) -> None:
        self.twist = np.zeros(6)

    def pose(self) -> FloatArray:
        """Return T_map_camera (4, 4) of the last frame by the current map, or the identity."""
        return np.eye(4) if self.last is None else self.last.current_pose(self._atlas)

    def in_map(self, covariance: FloatArray) -> FloatArray:
        """Return a covariance (6, 6), enlarged if the last frame is outside the main map."""
        return covariance if self.is_in_main_map else covariance + UNKNOWN_COVARIANCE

    @property
    def anchor_uid(self) -> int | None:
        """Return the uid of the keyframe to which the last frame is relative; None if unknown."""
        anchor = self._atlas.anchor(self.last.reference_uid) if self.last is not None else None
        if anchor is None or anchor.row is None:
            return None
        return int(self._atlas.keyframes.uid[anchor.row])

    @property
    def is_in_main_map(self) -> bool:
        """Return whether the last frame is in the main map.

        It is also True if there is no last frame, while the very first keyframe is pending, and if
        the reference keyframe of the last frame was removed long ago.
        """
        keyframes = self._atlas.keyframes
        anchor = self._atlas.anchor(self.last.reference_uid) if self.last is not None else None
        if anchor is None or anchor.row is None:  # no pose, or the first map has no keyframe yet
            return anchor is None or len(keyframes) == 0
        return int(keyframes.map_id[anchor.row]) == main_map(keyframes)

    def _observe(self, T_last_camera: FloatArray, elapsed_ns: int) -> None:
        self._elapsed_s = S_PER_NS * elapsed_ns
        if elapsed_ns > 0:
            self.twist = se3.log(se3.inverse(T_last_camera)) / (S_PER_NS * elapsed_ns)
        else:
            self.twist = np.zeros(6)
        for source in self._sources:
            source.observe(T_last_camera)

    def _bridged_motion(self) -> BridgedMotion | None:
        """Return the motion of the first source that has measured it; None: no source has.

        Sources that measure the position come before the gyro, which measures only rotations.
        """
        motions = (source.bridge() for source in self._sources)
        known = [
            motion
            for motion in motions
            if motion is not None and self._is_valid(motion.T_last_camera)
        ]
        return min(known, key=lambda motion: motion.is_short, default=None)

    def _is_valid(self, T: FloatArray) -> bool:
        return self._atlas.guard.is_valid(T, 'motion sources')

    def _update_covariances(self, tracking: TrackerOutput, T_last_camera: FloatArray) -> None:
        """Update the covariances from the residuals and, if known, from the pose noise.

        If too few map points are seen, the tracker measures only the motion since the last frame,
        and the covariance of the last pose is added to that of this motion. Errors that last and
        those of a recent bridge are added once.
        """
        consensus = tracking.consensus
        noise = self._pose_noise.covariance(consensus.image_covariance)
        if noise is None:
            own, self.image_covariance = consensus.covariance, consensus.image_covariance
        else:
            own = noise + consensus.image_covariance
            self.image_covariance = noise + consensus.ambiguity
        if not tracking.is_on_map:
            A = se3.adjoint(se3.inverse(T_last_camera))
            own = own + A @ self._own_covariance @ A.T
        if consensus.disagreement is not None:
            self._lasting_noise.add(consensus.disagreement)
        self._own_covariance = own
        self.covariance = own + self._lasting_noise.covariance
        elapsed_ns = tracking.tracked.frame.stamp_ns - self._bridged_ns
        if 0 <= S_PER_NS * elapsed_ns <= _INHERITED_S:
            self.covariance = self.covariance + self._bridged_covariance

    @property
    def _is_bridged(self) -> bool:
        return self.T_odom_camera is not self._T_odom_last

    def _move(self, T_last_camera: FloatArray) -> None:
        self.T_odom_camera = se3.orthonormalized(self._T_odom_last @ T_last_camera)
