"""RGB-D SLAM: features in, poses and a map out."""

from __future__ import annotations

import time

import numpy as np

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.values import CameraModel, Features, FloatArray, IntArray, Trajectory
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapper import KeyframeRequest
from rgbd_slam.model.atlas import Atlas, Redirect
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_state import MapState, snapshot
from rgbd_slam.model.point_tallies import PointTallies
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_frame
from rgbd_slam.model.trajectory import (
    TrajectoryRecorder,
    keyframe_poses,
    keyframe_trajectory,
    main_map,
)
from rgbd_slam.optimize.online_noise import OnlineNoise
from rgbd_slam.optimize.pose_optimizer import covariance
from rgbd_slam.processes.mapper_link import InlineMapper, MapperLink
from rgbd_slam.processes.mapper_process import MapperProcess
from rgbd_slam.tracking.image_clock import ImageClock
from rgbd_slam.tracking.keyframe_policy import KeyframePolicy
from rgbd_slam.tracking.motion import ConstantVelocity
from rgbd_slam.tracking.relocalization import Relocalizer
from rgbd_slam.tracking.tracker import Tracker, TrackerOutput
from rgbd_slam.tracking.tracking_result import SlamStats, TrackingResult, TrackingState

_MS = 1e3
_MIN_FIRST_FEATURES = 50  # with depth, to start a map; triangulation adds to them
# What a camera may have turned and gone while lost, as standard deviations [rad, m]: of poses in
# a map that nothing has joined with the main one.
_UNKNOWN_COVARIANCE = np.diag(np.square([np.pi] * 3 + [10.0] * 3))


class RgbdSlam:
    """Keyframe SLAM on the features of RGB-D images (Mur-Artal and Tardos, T-RO 2017).

    Args:
        camera: The camera of the images that the features come from.
        config: Parameters.
        background: Map in a process of its own, as live; otherwise at once, so that runs repeat.
            Call `close` in the end.
    """

    def __init__(
        self, camera: CameraModel, config: SlamConfig, *, background: bool = False
    ) -> None:
        self._config = config
        self._model = camera
        self._camera = StereoCamera.from_model(camera, config.camera)
        self._atlas = Atlas(config.camera.scale_factor, config.camera.num_octaves)
        close_limit_m = config.camera.close_baselines * config.camera.baseline_m
        self._policy = KeyframePolicy(
            self._atlas, config.keyframes, self._camera.baseline_px_m / close_limit_m
        )
        self._tracker = Tracker(self._camera, self._atlas, config.tracking, config.seed)
        link = MapperProcess if background else InlineMapper
        self._mapper: MapperLink = link(self._camera, self._atlas, config)
        self._relocalizer = Relocalizer(self._atlas, self._camera, self._tracker, config)
        self.is_mapping = True  # otherwise the map stays as it is
        self._num_maps = 0
        self._num_relocalizations = 0
        self._trajectory = TrajectoryRecorder()
        self._last: TrackedFrame | None = None
        self._clock = ImageClock()
        self._motion = ConstantVelocity()
        self._T_odom_camera = np.eye(4)
        self._tallies = PointTallies(self._atlas.points)
        self._noise = OnlineNoise(self._camera)

    def process(self, features: Features) -> TrackingResult:
        """Track one frame, and map it when it shows something new.

        Raises:
            MessageError: A feature is of an octave that the configuration does not know.
        """
        start_s = time.thread_time()
        _check_octaves(features, self._config.camera.num_octaves)
        frame = Frame.from_features(features, self._model, self._camera)
        if self._clock.add(frame.stamp_ns):
            self._motion.forget()
            self._policy.restart()
        self._redirect(self._mapper.update())
        if len(self._atlas.keyframes) == 0:
            return self._start(frame, np.eye(4))
        tracking = None
        if self._last is not None:
            elapsed_ns = frame.stamp_ns - self._last.frame.stamp_ns
            tracking = self._tracker.track(frame, self._last, self._motion.predict(elapsed_ns))
        if tracking is None:
            tracking = self._relocalized(frame)
        if tracking is None:
            return self._lost(frame)
        self._advance(tracking)
        insert = self.is_mapping and self._policy.wants(tracking, self._mapper.queue_length)
        tracked_s = time.thread_time()
        T_map_camera = tracking.tracked.T_map_camera
        if insert:
            self._insert_keyframe(tracking)
        mapped_s = time.thread_time()
        return TrackingResult(
            frame.stamp_ns,
            TrackingState.TRACKING,
            T_map_camera,
            self._T_odom_camera,
            self._covariance(tracking),
            tracking.num_matches,
            tracking.num_inliers,
            insert,
            {'track': _MS * (tracked_s - start_s), 'map': _MS * (mapped_s - tracked_s)},
        )

    def reconfigure(self, config: SlamConfig) -> None:
        """Take over parameters that may change at run time."""
        self._config = config
        self._policy.config = config.keyframes

    def _start(self, frame: Frame, T_map_camera: FloatArray) -> TrackingResult:
        """Start a map at a pose; the first one, or a new one after a loss."""
        is_first = len(self._atlas.keyframes) == 0
        if np.count_nonzero(frame.has_depth & frame.may_seed) < _MIN_FIRST_FEATURES:
            state = TrackingState.NOT_INITIALIZED if is_first else TrackingState.LOST
            return TrackingResult(frame.stamp_ns, state)
        i = self._mapper.start_map(frame, T_map_camera, self._num_maps)
        self._policy.inserted(frame.stamp_ns)
        self._num_maps += 1
        points = self._atlas.keyframes.point_of_feature[i, : len(frame)].astype(np.int64)
        self._last = tracked_frame(frame, T_map_camera, points, self._atlas, i)
        self._record(self._last)
        return TrackingResult(
            frame.stamp_ns, TrackingState.TRACKING, T_map_camera, self._T_odom_camera,
            np.zeros((6, 6)) if is_first else _UNKNOWN_COVARIANCE, len(points), len(points),
            is_keyframe=True,
        )  # fmt: skip

    def _covariance(self, tracking: TrackerOutput) -> FloatArray:
        """Return how well the pose is known: in the main map, not in one started since a loss."""
        in_own_map = covariance(tracking.estimate)
        return in_own_map if self.is_in_main_map else in_own_map + _UNKNOWN_COVARIANCE

    def _relocalized(self, frame: Frame) -> TrackerOutput | None:
        """Find a lost frame in the map; how it moved since the last one stays unknown."""
        tracking = self._relocalizer.relocalize(frame)
        if tracking is not None:
            self._num_relocalizations += 1
            self._last = tracking.tracked
        return tracking

    def _lost(self, frame: Frame) -> TrackingResult:
        """Give up on a frame; when lost for long, map anew from where the camera was last."""
        self._motion.forget()
        if self.is_mapping and self._clock.lost_s > self._config.places.new_map_after_s:
            T = np.eye(4) if self._last is None else self._last.current_pose(self._atlas)
            return self._start(frame, T)
        return TrackingResult(frame.stamp_ns, TrackingState.LOST)

    def _advance(self, tracking: TrackerOutput) -> None:
        """Take the motion since the last frame, both poses by the map as it is now."""
        assert self._last is not None
        T_map_last = self._last.current_pose(self._atlas)
        T_last_camera = se3.inverse(T_map_last) @ tracking.tracked.T_map_camera
        elapsed_ns = tracking.tracked.frame.stamp_ns - self._last.frame.stamp_ns
        self._motion.observe(se3.inverse(T_last_camera), elapsed_ns)
        self._T_odom_camera = se3.orthonormalized(self._T_odom_camera @ T_last_camera)
        self._last = tracking.tracked
        self._tallies.add(tracking.tally)
        self._tracker.camera = self._noise.add(tracking.tracked, self._atlas)
        self._record(tracking.tracked)

    def _insert_keyframe(self, tracking: TrackerOutput) -> None:
        tracked = tracking.tracked
        keep_outliers = self._config.keyframes.keep_outliers
        points = tracking.matched if keep_outliers else tracked.points
        request = KeyframeRequest(
            tracked.frame,
            tracked.T_reference_camera,
            tracked.reference_uid,
            points,
            self._atlas.points.uid[points],
            self._tallies.take(),
            self._tracker.camera,
        )
        self._policy.inserted(tracked.frame.stamp_ns)
        i = self._mapper.insert(request)
        self._redirect(self._mapper.update())
        if i is not None:
            keyframes = self._atlas.keyframes
            points = keyframes.point_of_feature[i, : len(tracked.frame)].astype(np.int64)
            if keep_outliers:  # only in the map
                points[tracking.is_outlier] = NO_POINT
            self._last = tracked_frame(
                tracked.frame, keyframes.T_map_camera[i].copy(), points, self._atlas, i
            )

    def _record(self, tracked: TrackedFrame) -> None:
        self._clock.recognised()
        self._trajectory.add(
            tracked.frame.stamp_ns,
            tracked.T_map_camera,
            tracked.reference_uid,
            tracked.T_reference_camera,
        )

    def _redirect(self, redirects: tuple[Redirect, ...]) -> None:
        """Hang what was relative to removed keyframes on those that took their place."""
        self._trajectory.redirect(redirects)
        if redirects and self._last is not None:
            self._last = self._last.redirected(redirects)

    def state(self) -> MapState:
        """Copy the map, in a few ms."""
        return snapshot(self._atlas)

    def load(self, state: MapState, *, keep: bool) -> IntArray:
        """Lay a saved map over the running one and return the (K,) uids of its keyframes.

        Args:
            state: The saved map.
            keep: Go on in the running map beside it, until a known place joins the two;
                otherwise the running map is gone and the camera is looked for in the saved one.
        """
        self._mapper.load(state, keep=keep)
        self._redirect(self._mapper.update())
        if not keep:
            self._last = None
            self._clock.recognised()  # there is time to find the camera in it
            self._motion.forget()
        keyframes = self._atlas.keyframes
        self._num_maps = 1 + int(keyframes.map_id[keyframes.alive].max())
        return np.sort(keyframes.uid[keyframes.alive])[-len(state) :]

    @property
    def is_settled(self) -> bool:
        """Return whether the map stays as it is while no keyframe is made."""
        self._redirect(self._mapper.update())
        return self._mapper.is_settled

    def settle(self) -> None:
        """Ask for a last adjustment of what has grown; without waiting, see `is_settled`."""
        self._mapper.settle()

    def finish(self) -> None:
        """Let the map settle after the last frame, and wait for it."""
        self._redirect(self._mapper.finish())

    def close(self) -> None:
        """End what runs in the background; poses and map can still be read."""
        self._mapper.close()

    @property
    def mapper_queue(self) -> int:
        """Return how many keyframes wait for the mapper or are being taken in."""
        return self._mapper.queue_length

    @property
    def num_mapper_restarts(self) -> int:
        """Return how often a mapping process had died and was replaced."""
        return self._mapper.num_restarts

    def trajectory_online(self) -> Trajectory:
        """Return the poses as they were given out."""
        return self._trajectory.online()

    def trajectory_final(self) -> Trajectory:
        """Return the poses of the frames tracked in the main map, as it is now."""
        return self._trajectory.final(self._atlas.keyframes)

    def keyframe_trajectory(self) -> Trajectory:
        """Return the poses of this session's keyframes in the main map."""
        return keyframe_trajectory(self._atlas.keyframes)

    def keyframe_poses(self) -> KeyframePoses:
        """Return where the keyframes of all maps are."""
        return keyframe_poses(self._atlas)

    def last_pose(self) -> tuple[FloatArray, int]:
        """Return T_map_camera (4, 4) of the last tracked frame, as the map says now.

        With it comes the uid of the keyframe that the pose hangs on.
        """
        assert self._last is not None
        return self._last.current_pose(self._atlas), self._last.reference_uid

    def map_points_m(self) -> FloatArray:
        """Return (N, 3) points of the main map."""
        points = self._atlas.points
        is_main = points.map_id == main_map(self._atlas.keyframes)
        return np.asarray(points.position_m[points.alive & is_main])

    @property
    def is_in_main_map(self) -> bool:
        """Return whether the last tracked frame is in the map that most keyframes are in."""
        keyframes = self._atlas.keyframes
        i = keyframes.index_of(self._last.reference_uid) if self._last is not None else None
        return i is None or int(keyframes.map_id[i]) == main_map(keyframes)

    @property
    def stats(self) -> SlamStats:
        """Return counts of the main map and of events."""
        keyframes, points = self._atlas.keyframes, self._atlas.points
        ids, main = keyframes.map_id[keyframes.alive], main_map(keyframes)
        loops = self._mapper.loops
        return SlamStats(
            int(np.count_nonzero(ids == main)),
            int(np.count_nonzero(points.alive & (points.map_id == main))),
            len(np.unique(ids)),
            loops.closed,
            loops.merged,
            self._num_relocalizations,
        )


def _check_octaves(features: Features, num_octaves: int) -> None:
    """Refuse what the tables of scales and weights, here and in native code, do not hold."""
    highest = int(features.octave.max(initial=0))
    if highest >= num_octaves:
        raise MessageError(
            f'features.octave: {highest} is beyond the camera.num_octaves of SLAM, {num_octaves}: '
            "set it to the filter's extraction.num_levels"
        )
