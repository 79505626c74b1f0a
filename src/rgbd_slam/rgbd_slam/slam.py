"""RGB-D SLAM: features in, poses and a map out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import CameraModel, Features, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.mapping.mapper import KeyframeRequest
from rgbd_slam.mapping.slam_map import SlamMap, SlamStats
from rgbd_slam.model.frame import Frame, check_octaves
from rgbd_slam.model.points import PointTallies
from rgbd_slam.model.tracked_frame import tracked_keyframe
from rgbd_slam.optimize.measured_noise import NoiseEstimator
from rgbd_slam.places.pose_hint import PoseHint
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.tracking.image_stream import RepeatedImages, Repetition
from rgbd_slam.tracking.inertial_motion import InertialMotion
from rgbd_slam.tracking.keyframe_policy import KeyframePolicy
from rgbd_slam.tracking.motion_sources import MotionSource
from rgbd_slam.tracking.odometry import Bridge, Odometry
from rgbd_slam.tracking.relocalization import Relocalizer
from rgbd_slam.tracking.rolling_shutter import RollingShutter
from rgbd_slam.tracking.tracker import Tracker, TrackerOutput
from rgbd_slam.tracking.tracking_result import TrackingResult
from rgbd_slam.tracking.tracking_state import TrackingStates
from rgbd_slam.tracking.warm_up import WarmUp

_MS = 1e3  # milliseconds per second; durations are by the monotonic clock (decision 016)
# Number of features with depth that a new map needs. Chosen, not tuned; ORB-SLAM3 needs 500
# (Tracking.cc, StereoInitialization). Triangulation later adds points to the map.
_MIN_FIRST_FEATURES = 50


class RgbdSlam:
    """Keyframe SLAM on the features of RGB-D images (Mur-Artal and Tardos, T-RO 2017).

    `map` has keyframes, points and mapper, `odometry` the last tracked pose, `states` the tracking
    state, and `trajectory` the poses of all frames. The arguments are those of `SlamSession`;
    without `frames`, the camera is assumed to be level at the start.
    """

    def __init__(
        self,
        camera: CameraModel,
        config: SlamConfig,
        frames: RobotFrames | None = None,
        *,
        background: bool = False,
        imu: Imu | None = None,
        motion_sources: Sequence[MotionSource] = (),
    ) -> None:
        self._config = config
        self._model = camera
        self.map = SlamMap(camera, config, frames or RobotFrames(), background=background)
        self.map.on_replaced = self._forget_pose
        atlas, stereo = self.map.atlas, self.map.stereo
        self._atlas, self._camera, self.trajectory = atlas, stereo, self.map.recorder
        self._warm_up = WarmUp(atlas, self.trajectory, config.tracking)
        gyro = None if imu is None else InertialMotion(imu)
        self.odometry = Odometry(atlas, gyro, motion_sources)
        self.states = TrackingStates(atlas, stereo, config)
        self._repeated = RepeatedImages()
        self._tracked: TrackingResult | None = None  # result for the last tracked image
        self._noise = NoiseEstimator(stereo)
        self._shutter = RollingShutter(*camera.size_px)
        self._exposed: Frame  # the current image, not compensated for rolling shutter
        self._tracker = Tracker(stereo, atlas, config.tracking, config.seed)
        if imu is not None:
            self._tracker.min_inliers = self.odometry.min_inliers
        self._relocalizer = Relocalizer(atlas, self.map.places, self._tracker)
        close_px = stereo.baseline_px_m / config.camera.close_limit_m
        self._policy = KeyframePolicy(atlas, config.keyframes, close_px)
        self._tallies = PointTallies(atlas.points)

    def process(self, features: Features) -> TrackingResult:
        return self.learn(self.track(features))

    def track(self, features: Features) -> TrackingResult:
        """Estimate the pose of a frame. Call `learn` before tracking the next one.

        First, changes that the mapper has finished are applied to the map. An image that repeats
        the last tracked one only gets a predicted pose (`RepeatedImages`). MessageError if an
        octave is not below the configured number.
        """
        repetition, original = self._repeated.add(features), self._tracked
        if (
            original is not None
            and repetition is not Repetition.NOTHING
            and self._repeated.original_ns == original.stamp_ns
        ):
            return self._predict(original, features.stamp_ns, repetition)
        frame, start_s = self._prepare(features), time.perf_counter()
        self.map.update()
        self.odometry.follow(frame.stamp_ns)
        tracking = None if self.map.is_empty else self._find(frame)
        if tracking is not None:
            result = self._tracked = self._result(tracking, start_s)
        elif self.map.is_empty:
            self.states.no_map()
            result = self._start_map(frame, None)
        else:
            result = self._miss(frame)
        return replace(result, note=self._relocalizer.consume_note() or result.note)

    def learn(self, result: TrackingResult) -> TrackingResult:
        """Update estimates and trajectory from a tracked frame, and insert it if it is a keyframe.

        Return the result of `track` with `is_keyframe` and `stage_ms` completed.
        """
        tracking = result.to_learn
        if tracking is None:  # lost, or the first frame of a map
            return result
        start_s = time.perf_counter()
        self._update_estimates(tracking)
        is_keyframe = self.map.takes_keyframes and self._policy.wants(tracking)
        learned_s = time.perf_counter()
        if is_keyframe:
            self._insert_keyframe(tracking)
        mapped_s = time.perf_counter()
        track_ms = result.stage_ms['track'] + _MS * (learned_s - start_s)
        stage_ms = {'track': track_ms, 'map': _MS * (mapped_s - learned_s)}
        return replace(result, is_keyframe=is_keyframe, stage_ms=stage_ms, to_learn=None)

    def relocalize_near(self, hint: PoseHint) -> None:
        """Discard the current pose; relocalize near `hint` first, then in the whole map."""
        self._relocalizer.relocalize_near(hint)
        self._forget_pose()

    def reconfigure(self, config: SlamConfig) -> None:
        self._config = config
        self.states.new_map_after_s = config.places.new_map_after_s
        self._policy.reconfigure(config.keyframes)

    @property
    def stats(self) -> SlamStats:
        return self.map.stats(self._relocalizer.num_found)

    def _prepare(self, features: Features) -> Frame:
        """Return the undistorted frame with u_right."""
        check_octaves(features, self._config.camera.num_octaves)
        frame = Frame.from_features(features, self._model, self._camera)
        if self.states.image(frame.stamp_ns):
            self.odometry.forget_velocity()
            self._policy.restart()
        return frame

    def _find(self, frame: Frame) -> TrackerOutput | None:
        """Track a frame from the last one, or relocalize it; None: the camera is lost.

        After relocalization, T_odom_camera moves by the motion that a source has measured since.
        """
        odometry, last, num_bridged = self.odometry, self.odometry.last, self.states.num_bridged
        bridge = odometry.bridge() if num_bridged else None
        tracking = None
        self._exposed = frame
        frame = self._shutter.compensated(frame, self._camera, odometry.twist_at(frame.stamp_ns))
        if last is not None:
            prior = odometry.prior()
            corrected = self._corrected if self._shutter.readout_s else None
            tracking = self._tracker.track(
                frame, last, *odometry.predict(), prior=prior, corrected=corrected
            )
        if tracking is None:
            # While the map grows, a later merge connects a map that is not the main one. In
            # localization, there is no merge.
            in_main_map = not self.map.is_growing
            tracking = self._relocalizer.relocalize(frame, in_main_map=in_main_map)
            if tracking is None:
                return None
            odometry.bridge()
            odometry.restart_from(tracking.tracked)
        odometry.advance(tracking)
        if bridge is not None:
            self.trajectory.end_bridge(num_bridged, bridge.T_map_camera, tracking.tracked)
        self.states.tracked(tracking.tracked.frame, is_on_map=tracking.is_on_map)
        return tracking

    def _corrected(self, T_last_camera: FloatArray) -> Frame:
        """Return the current frame, compensated for the velocity of a motion (4, 4)."""
        twist = self.odometry.twist_by(T_last_camera, self._exposed.stamp_ns)
        return self._shutter.compensated(self._exposed, self._camera, twist)

    def _result(self, tracking: TrackerOutput, start_s: float) -> TrackingResult:
        return TrackingResult(
            tracking.tracked.frame.stamp_ns,
            SlamState.TRACKING,
            T_map_camera=tracking.tracked.T_map_camera,
            T_odom_camera=self.odometry.T_odom_camera,
            covariance=self.odometry.in_map(self.odometry.covariance),
            image_covariance=self.odometry.image_covariance,
            num_tracked=tracking.num_matches,
            num_inliers=tracking.num_inliers,
            stage_ms={'track': _MS * (time.perf_counter() - start_s)},
            competing=tracking.consensus.competing,
            note=self.states.note,
            to_learn=tracking,
        )

    def _predict(
        self, original: TrackingResult, stamp_ns: int, repetition: Repetition
    ) -> TrackingResult:
        """Return and record the predicted pose of an image that repeats the last tracked one."""
        self.odometry.follow(stamp_ns)
        T_last_camera = np.eye(4)
        if repetition is Repetition.COLOR:
            T_last_camera = se3.inverse(self.odometry.predict()[0])
        copy = self.odometry.extrapolated(stamp_ns, T_last_camera)
        self.trajectory.add(copy)
        return replace(
            original,
            stamp_ns=stamp_ns,
            T_map_camera=copy.T_map_camera,
            T_odom_camera=self.odometry.T_odom_camera @ T_last_camera,
            is_keyframe=False,
            is_predicted=True,
            to_learn=None,
        )

    def _start_map(self, frame: Frame, bridge: Bridge | None) -> TrackingResult:
        """Start a map with this frame at its bridged pose, else at the last pose or the origin.

        If a gyro has bridged the loss, the new map is linked with the last one. With too few
        features with depth, or while a saved map is being loaded, no map is started, and the
        result has no pose.
        """
        num_features = np.count_nonzero(frame.has_depth & frame.may_seed)
        if self.map.is_loading or num_features < _MIN_FIRST_FEATURES:
            state = SlamState.NOT_INITIALIZED if self.map.is_empty else SlamState.LOST
            return TrackingResult(frame.stamp_ns, state)
        before = self.odometry.last
        pose = self.odometry.pose() if bridge is None else bridge.T_map_camera
        uid = self.map.start(frame, pose)
        self._policy.inserted(frame.stamp_ns)
        tracked = tracked_keyframe(frame, self._atlas, uid)
        if bridge is not None and bridge.is_short and before is not None:
            self.trajectory.link(before, tracked, bridge.T_last_camera)
        self.odometry.restart_from(tracked)
        self.states.started()
        self.trajectory.add(tracked)
        self._warm_up.begin(frame.stamp_ns)
        return TrackingResult(
            frame.stamp_ns,
            SlamState.TRACKING,
            T_map_camera=tracked.T_map_camera,
            T_odom_camera=self.odometry.T_odom_camera,
            covariance=self.odometry.in_map(np.zeros((6, 6))),
            image_covariance=np.zeros((6, 6)),
            num_tracked=len(frame),
            num_inliers=len(frame),
            is_keyframe=True,
        )

    def _miss(self, frame: Frame) -> TrackingResult:
        """Return the pose of a lost frame from a motion source, or start a new map with it."""
        odometry = self.odometry
        odometry.forget_velocity()
        bridge = odometry.bridge()
        is_short = bridge is not None and bridge.is_short
        self.states.missed(is_followed=bridge is not None, is_recorded=is_short)
        if self.map.takes_keyframes and self.states.wants_map(frame, odometry.last):
            started = self._start_map(frame, bridge)
            if started.is_keyframe:
                return started
        if bridge is None:
            return TrackingResult(frame.stamp_ns, SlamState.LOST)
        if is_short:
            self.trajectory.add(odometry.extrapolated(frame.stamp_ns, bridge.T_last_camera))
        return TrackingResult(
            frame.stamp_ns,
            SlamState.LOST,
            T_map_camera=bridge.T_map_camera,
            T_odom_camera=odometry.T_odom_camera,
            covariance=odometry.in_map(bridge.covariance),
            image_covariance=bridge.image_covariance,
            note=bridge.note,
        )

    def _update_estimates(self, tracking: TrackerOutput) -> None:
        """Update point counts, noise, rolling shutter, trajectory and initial poses (`WarmUp`)."""
        tracked = tracking.tracked
        self._tallies.add(tracking.tally)
        self._noise.add(tracked, self._atlas)
        if self._config.camera.rolling_shutter:
            view = self.odometry.moving_view(self._exposed, tracking.matched)
            self._shutter.add(view, self._noise.camera, self._atlas.octave_scale)
        self._tracker.use_camera(self._noise.camera)
        self.trajectory.add(tracked)
        self._warm_up.add(tracked)
        self._warm_up.reestimate_next(self._noise.camera)

    def _insert_keyframe(self, tracking: TrackerOutput) -> None:
        """Send the frame to the mapper; track the next one from this keyframe, even if pending."""
        sent = tracked = tracking.tracked
        keep_outliers, uid = self._config.keyframes.keep_outliers, self._atlas.points.uid
        if keep_outliers:
            sent = replace(tracked, points=tracking.matched, point_uids=uid[tracking.matched])
        self._policy.inserted(tracked.frame.stamp_ns)
        request = KeyframeRequest(
            self.map.reserve_uids(1),
            sent,
            self._tallies.take(),
            self._noise.camera,
            tracking.moved,
            uid[tracking.moved],
        )
        self.map.insert(request)
        if request.uid in self._atlas.pending:
            self.trajectory.become_keyframe(request.uid)
            here = replace(tracked, reference_uid=request.uid, T_reference_camera=np.eye(4))
            self.odometry.restart_from(here)
        elif self._atlas.keyframes.index_of(request.uid) is not None:
            only_in_map = tracking.is_outlier if keep_outliers else None
            self.odometry.restart_from(
                tracked_keyframe(tracked.frame, self._atlas, request.uid, only_in_map)
            )

    def _forget_pose(self) -> None:
        self.odometry.restart_from(None)
        self._tracked = None
        self.states.discarded()
        self.odometry.forget_velocity()
