"""SLAM for nodes, offline runs and experiments: features of an image in, pose and status out.

Only this module combines tracking and mapping. Its callers differ in the source of the images.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.errors import ConfigError
from hoid_common.poses.keyframe_poses import TrackedImage
from hoid_common.slam_status import SlamMode, SlamState, SlamStatus
from hoid_common.values import CameraModel, Features, FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.focal_length import FocalLengthCheck
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.late_verdicts import LateVerdicts
from rgbd_slam.leveling import Leveling
from rgbd_slam.places.pose_hint import PoseHint
from rgbd_slam.robot_frames import RobotFrames, RobotPose
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.image_stream import DroppedFrameCounter
from rgbd_slam.tracking.motion_sources import MotionSource
from rgbd_slam.tracking.tracking_result import TrackingResult

_MESSAGES = {
    SlamState.NOT_INITIALIZED: 'waiting for an image with enough static features that have depth',
    SlamState.TRACKING: '',
    SlamState.LOST: 'too few map points are seen; trying to recognize a mapped place',
    SlamState.PAUSED: 'paused; call ~/resume to continue',
}
_IN_OTHER_MAP = 'in a new map since the last loss; it is merged when a mapped place is recognized'
_TWO_MOTIONS = 'two motions explain this image: {:.0f} % / {:.0f} %; something large moves'
_LATE_S = 2.0  # chosen: many times the mapper's usual 20 to 50 ms per keyframe
_LATE_MAPPER = (
    'the mapper has not answered for {:.0f} s; {} requests wait and the map does not grow: free '
    'the computer'
)


class Tracked(NamedTuple):
    """The pose of an image, before `SlamSession.learn` has used the image."""

    pose: RobotPose | None  # None: the pose is unknown
    result: TrackingResult | None  # None: the session is paused


class Processed(NamedTuple):
    """The results for an image."""

    status: SlamStatus
    pose: RobotPose | None  # None: the pose is unknown
    image: TrackedImage | None = None  # None: no pose in the map was measured


class SlamSession:
    """Runs SLAM on a stream of features; `slam` is the core, `map` its map.

    Args:
        camera: The camera of the images.
        config: Parameters of the core.
        frames: The frames of the robot, with the mounting of the camera.
        background: True: the mapper runs in a separate process, as on a robot, which `close` ends.
            False: each keyframe is mapped before `learn` returns, so that runs repeat bit for bit.
        imu: An IMU, which predicts rotations and bridges short losses; the caller adds samples.
        motion_sources: Further sensors that predict motion, such as wheels (`ExternalOdometry`).

    Raises:
        ConfigError: No place index has the configured name.
        MapperStoppedError: The mapping process does not start. `track` and `learn` raise it too,
            if the process has ended for good or does not respond.
    """

    def __init__(
        self,
        camera: CameraModel,
        config: SlamConfig,
        frames: RobotFrames,
        *,
        background: bool = False,
        imu: Imu | None = None,
        motion_sources: Sequence[MotionSource] = (),
    ) -> None:
        self.camera, self.imu = camera, imu
        self.slam = RgbdSlam(
            camera, config, frames, background=background, imu=imu, motion_sources=motion_sources
        )
        self.map = self.slam.map
        self.focal_length = FocalLengthCheck(self.map.stereo)
        self.is_paused = False  # True: images are ignored
        self.stamp_ns = 0  # stamp of the latest tracked image
        self._frames, self._leveling = frames, Leveling(frames, imu)
        self._dropped = DroppedFrameCounter()
        self._late = LateVerdicts()
        self._num_processed = 0

    def reconfigure(self, config: SlamConfig) -> None:
        self.slam.reconfigure(config)

    def close(self) -> None:
        """End the mapping process; poses and map can still be read."""
        self.map.mapper.close()

    def process(self, features: Features) -> Processed:
        return self.learn(self.track(features))

    def track(self, features: Features) -> Tracked:
        """Estimate the pose of an image. Call `learn` before tracking the next one.

        While the session is paused, there is no pose. MessageError if an octave is not below the
        configured number.
        """
        self._dropped.add(features.stamp_ns)
        if self.is_paused:
            return Tracked(None, None)
        self.stamp_ns = features.stamp_ns
        result = self.slam.track(self._late.filtered(features))
        return Tracked(self._robot_pose(result), result)

    def learn(self, tracked: Tracked) -> Processed:
        """Update the map and all estimates from a tracked image; return all its results."""
        if tracked.result is None:
            return Processed(self._status(SlamState.PAUSED), None)
        result = self.slam.learn(tracked.result)
        self._num_processed += 1
        is_in_main_map = self.slam.odometry.is_in_main_map
        is_turned = self._leveling.update(result, is_in_main_map=is_in_main_map)
        self.map.has_changed |= result.is_keyframe or is_turned
        if result.is_keyframe:
            self._late.expect_verdict()
            self.focal_length.add_newest(self.map.atlas)
        status = self._status(result.state, result)
        return Processed(status, tracked.pose, self._image(result, is_in_main_map=is_in_main_map))

    def apply_verdicts(self, verdicts: FeatureVerdicts) -> None:
        """Remove the observations of features of a keyframe that turned out to be dynamic.

        Verdicts on an image that has not arrived yet are applied when it is tracked. Verdicts on
        an image that is not a keyframe, or had verdicts before, are ignored. MessageError if the
        keyframe has another number of features.
        """
        if self._late.changes_keyframe(verdicts):
            self.map.mapper.retract(verdicts)

    def status(self) -> SlamStatus:
        """Return the status between images: PAUSED, or else NOT_INITIALIZED."""
        return self._status(SlamState.PAUSED if self.is_paused else SlamState.NOT_INITIALIZED)

    @property
    def mode(self) -> SlamMode:
        return SlamMode.MAPPING if self.map.is_growing else SlamMode.LOCALIZATION

    def set_mode(self, mode: SlamMode) -> None:
        """Switch between extending the map and only localizing in it.

        Raises:
            ConfigError: There is no map to localize in.
            MapFileError: The camera differs too much from the map's to extend the map.
        """
        if mode is SlamMode.LOCALIZATION and self.map.is_empty:
            raise ConfigError('there is no map to localize in: load one, or map first')
        if mode is SlamMode.MAPPING:
            self.map.check_extendable()
        self.map.is_growing = mode is SlamMode.MAPPING

    def relocalize_near(self, T_map_base: FloatArray, sigma_m: float, sigma_rad: float) -> None:
        """Discard the pose; relocalize near a given pose first, then everywhere.

        T_map_base (4, 4) is the robot's pose as given in RViz, with x forward and z up; without a
        base frame, that of the camera's body axes. The standard deviations are those of position
        and heading. ConfigError if the session is mapping.
        """
        if self.map.is_growing:
            raise ConfigError('an initial pose needs the mode localization; see set_mode')
        hint = PoseHint(self._frames.camera_at(T_map_base), sigma_m, sigma_rad)
        self.slam.relocalize_near(hint)

    def _robot_pose(self, result: TrackingResult) -> RobotPose | None:
        if result.T_map_camera is None or result.T_odom_camera is None:
            return None
        covariance = np.zeros((6, 6)) if result.covariance is None else result.covariance
        pose = self._frames.robot_pose(
            result.stamp_ns,
            result.T_map_camera,
            result.T_odom_camera,
            covariance,
            result.image_covariance,
        )
        poses = np.stack([pose.T_map_odom, pose.T_odom_base])
        return pose if self.map.atlas.guard.are_valid(poses, 'the robot').all() else None

    def _image(self, result: TrackingResult, *, is_in_main_map: bool) -> TrackedImage | None:
        slam, keyframe_uid = self.slam, self.slam.odometry.anchor_uid
        is_measured = result.state is SlamState.TRACKING and not result.is_predicted
        if not is_measured or keyframe_uid is None:
            return None
        return TrackedImage(
            result.stamp_ns,
            self._frames.T_map_core @ slam.odometry.pose(),
            keyframe_uid,
            is_in_main_map,
            self.map.is_growing,
        )

    def _status(self, state: SlamState, result: TrackingResult | None = None) -> SlamStatus:
        stats = self.slam.stats
        return SlamStatus(
            state=state,
            mode=self.mode,
            message=self._message(state, result),
            tracked_points=result.num_tracked if result else 0,
            inliers=result.num_inliers if result else 0,
            keyframes=stats.num_keyframes,
            map_points=stats.num_map_points,
            maps=stats.num_maps,
            mapper_queue=self.map.mapper.queue_length,
            loops=stats.num_loops,
            merges=stats.num_merges,
            relocalizations=stats.num_relocalizations,
            frames_processed=self._num_processed,
            frames_dropped=self._dropped.num_dropped,
            stage_ms=result.stage_ms if result else {},
        )

    def _message(self, state: SlamState, result: TrackingResult | None) -> str:
        """Return a text that explains the state; '' if tracking is undisturbed."""
        waiting_s = self.map.mapper.waiting_s
        if state is SlamState.TRACKING and waiting_s > _LATE_S:
            return _LATE_MAPPER.format(waiting_s, self.map.mapper.queue_length)
        if result is not None and result.note:
            return result.note
        if state is SlamState.TRACKING and not self.slam.odometry.is_in_main_map:
            return _IN_OTHER_MAP
        if result is not None and result.competing is not None:
            competing = result.competing
            shares = competing.chosen_ratio, competing.competing_ratio
            return _TWO_MOTIONS.format(*(100 * share for share in shares))
        return _MESSAGES[state]
