"""The core as it is run, live and offline: which images are tracked, and which are looked at.

This is the only place where picking, tracking and fusing come together. Nodes, offline runs and
benchmarks differ in what brings images here, and in where the scene mapper is that sees those
picked.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hoid_common.errors import ConfigError
from hoid_common.slam_status import SlamMode, SlamState, SlamStatus
from hoid_common.values import CameraModel, Features, FeatureVerdicts, FloatArray, Trajectory
from rgbd_slam import map_transfer
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.late_verdicts import LateVerdicts
from rgbd_slam.map_control import MapControl
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.map_transfer import LoadedMap
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.places.pose_hint import PoseHint
from rgbd_slam.robot_frames import RobotFrames, RobotPose
from rgbd_slam.scene.fusion_scheduler import FusionRequest, FusionScheduler
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.statistics import SlamStats, status_message
from rgbd_slam.tracking.motion import MotionSource
from rgbd_slam.tracking.stream_gaps import StreamGaps
from rgbd_slam.tracking.tracking_result import TrackingResult, TrackingState


class Tracked(NamedTuple):
    """Where one image was taken, and what is still to be learned from it."""

    pose: RobotPose | None  # None while the pose is unknown
    result: TrackingResult | None  # None while the session is paused


class Processed(NamedTuple):
    """What one image gave."""

    status: SlamStatus
    pose: RobotPose | None  # None while the pose is unknown
    fusion: FusionRequest | None = None  # for the scene mapper, when it is to look at the image


class SlamSession:
    """Feeds the core, picks what the scene mapper is to look at, and says how all is doing.

    Args:
        camera: The camera of the images that the features come from.
        config: Parameters of the core.
        frames: Where the camera sits on the robot.
        background: Map in a process of its own; `close` ends it.
        fusion_scheduler: Picks the images that the scene mapper is to look at.
        wheels: Somebody else's odometry, of the camera.
    """

    def __init__(
        self,
        camera: CameraModel,
        config: SlamConfig,
        frames: RobotFrames,
        *,
        background: bool = False,
        fusion_scheduler: FusionScheduler | None = None,
        wheels: MotionSource | None = None,
    ) -> None:
        self.camera = camera
        self._is_paused = False
        self._config = config
        self._frames = frames
        self._background, self._wheels = background, wheels
        self._fusion_scheduler = fusion_scheduler or FusionScheduler(None, None)
        self._map_changed = False
        self._stats_shown: SlamStats | None = None
        self._begin()

    def reset(self) -> None:
        """Forget the map and all counts."""
        self.close()
        self._begin()

    def reconfigure(self, config: SlamConfig, fusion_scheduler: FusionScheduler) -> None:
        """Take over parameters that may change at run time."""
        self._config, self._fusion_scheduler = config, fusion_scheduler
        self._slam.reconfigure(config)

    def close(self) -> None:
        """End what runs in the background; poses and map can still be read."""
        self.map.close()

    @property
    def map(self) -> MapControl:
        """Return what steers the life of the map; another one after `reset`."""
        return self._slam.map

    def pause(self) -> None:
        """Ignore images until `resume`."""
        self._is_paused = True

    def resume(self) -> None:
        """Track images again."""
        self._is_paused = False

    def process(self, features: Features) -> Processed:
        """Track one image and learn from it."""
        return self.learn(self.track(features))

    def track(self, features: Features) -> Tracked:
        """Say where one image was taken, unless paused; `learn` is to follow before the next."""
        self._gaps.add(features.stamp_ns)
        if self._is_paused:
            return Tracked(None, None)
        self.stamp_ns = features.stamp_ns
        result = self._slam.track(self._late.filtered(features))
        return Tracked(self._pose(result), result)

    def learn(self, tracked: Tracked) -> Processed:
        """Take in what the image says, and tell how all is doing."""
        if tracked.result is None:
            return Processed(self._status(SlamState.PAUSED), None)
        result = self._slam.learn(tracked.result)
        self._num_processed += 1
        self._map_changed |= result.is_keyframe
        if result.is_keyframe:
            self._late.note_keyframe()
        status = self._status(SlamState(result.state.value), result)
        return Processed(status, tracked.pose, self._fusion_request(result))

    def judge_again(self, verdicts: FeatureVerdicts) -> None:
        """Take back what the map has of features that move after all.

        Raises:
            MessageError: The verdicts are not those of the image with their stamp.
        """
        if self._late.is_due(verdicts):
            self.map.take_back(verdicts)

    @property
    def stats(self) -> SlamStats:
        """Return counts of the main map and of events."""
        return self._slam.stats

    def status(self) -> SlamStatus:
        """Return how the session is doing between two images."""
        return self._status(SlamState.PAUSED if self._is_paused else SlamState.NOT_INITIALIZED)

    @property
    def mode(self) -> SlamMode:
        """Whether the map grows."""
        return SlamMode.MAPPING if self.map.is_growing else SlamMode.LOCALIZATION

    def set_mode(self, mode: SlamMode) -> None:
        """Let the map grow, or leave it as it is once it has settled.

        Raises:
            ConfigError: There is no map to localise in.
        """
        if mode is SlamMode.LOCALIZATION and self.map.is_empty:
            raise ConfigError('there is no map to localise in: load one, or map first')
        self.map.set_growing(is_growing=mode is SlamMode.MAPPING)

    def look_first_at(self, T_map_base: FloatArray, sigma_m: float, sigma_rad: float) -> None:
        """Look for the robot at a pose (4, 4) first, from the next image on.

        Args:
            T_map_base: As in RViz: x forward, z up, without a base as well.
            sigma_m: Standard deviation of the place.
            sigma_rad: Of the direction.

        Raises:
            ConfigError: The map grows.
        """
        if self.map.is_growing:
            raise ConfigError('a pose is looked for in localization only; see set_mode')
        hint = PoseHint(self._frames.camera_at(T_map_base), sigma_m, sigma_rad)
        self._slam.look_first_at(hint)

    def saved_map(self) -> MapFile:
        """Copy the map for a file; see `map_transfer.export_map`."""
        return map_transfer.export_map(self._slam, self._frames, self.camera, self._config.camera)

    def load(self, content: MapFile, *, keep: bool = False) -> LoadedMap:
        """Lay a saved map over the running one; see `map_transfer.import_map`."""
        loaded = map_transfer.import_map(
            self._slam, self._frames, self.camera, self._config.camera, content, keep=keep
        )
        self._map_changed = True
        return loaded

    def all_keyframes(self) -> KeyframePoses:
        """Return where the keyframes of all maps are, those of the main map in the map frame."""
        return self._frames.keyframes(self.map.keyframe_poses())

    def take_map_changed(self) -> bool:
        """Return whether the map is another than at the last call."""
        stats = self._slam.stats
        changed = self._map_changed or stats != self._stats_shown
        self._map_changed, self._stats_shown = False, stats
        return changed

    def trajectory(self, kind: str) -> Trajectory:
        """Return the camera's poses in the map: final, online or keyframes.

        Final ones are by the map as it is: whoever wants it settled asks for that before.

        Raises:
            ConfigError: Another kind.
        """
        return Trajectory.joined(self.trajectory_parts(kind))

    def trajectory_parts(self, kind: str) -> Iterator[Trajectory]:
        """Return the same as `trajectory` bit by bit, for any thread."""
        self._map_changed |= kind == 'final'  # settling moves it without a trace in the counts
        return map(self._frames.cameras, self._slam.trajectory.parts(kind))

    @property
    def num_unwritten(self) -> int:
        """Return how many old poses are in memory because no file takes them."""
        return self._slam.trajectory.num_unwritten

    def path(self) -> Trajectory:
        """Return the base's poses at the keyframes, as the map says now."""
        return self._frames.bases(self._slam.trajectory.keyframes())

    def map_points_m(self) -> FloatArray:
        """Return (N, 3) points in the map frame."""
        return self._frames.points_m(self.map.points_m())

    def keyframe_poses(self) -> FloatArray:
        """Return (N, 4, 4) T_map_camera of the main map's keyframes."""
        keyframes = self.all_keyframes()
        return keyframes.T_map_camera[keyframes.is_main]

    def _begin(self) -> None:
        self._slam = RgbdSlam(
            self.camera, self._config, background=self._background, wheels=self._wheels
        )
        self._gaps = StreamGaps()
        self._late = LateVerdicts()
        self._num_processed = 0
        self._map_changed = False
        self._stats_shown = None
        self.stamp_ns = 0  # of the latest image

    def _pose(self, result: TrackingResult) -> RobotPose | None:
        if result.T_map_camera is None or result.T_odom_camera is None:
            return None
        covariance = np.zeros((6, 6)) if result.covariance is None else result.covariance
        return self._frames.place(
            result.stamp_ns, result.T_map_camera, result.T_odom_camera, covariance,
            result.image_covariance,
        )  # fmt: skip

    def _fusion_request(self, result: TrackingResult) -> FusionRequest | None:
        """Return what is to be known of an image that the scene mapper is to look at.

        Images are fused wherever a map grows: the dense map keeps those of maps beside the main
        one unseen until a known place joins the two, and they would be missing there otherwise.
        Objects are looked for in the main map only, as tracks cannot wait, but in localisation as
        well: where people and things are now is no part of the map.
        """
        last = self._slam.odometry.last
        if result.state is not TrackingState.TRACKING or last is None:
            return None
        fusion = self._fusion_scheduler.pick(
            result.stamp_ns,
            self._frames.T_map_core @ self._slam.odometry.pose(),
            last.reference_uid,
            self.all_keyframes,
        )
        if fusion is None:
            return None
        fuse = fusion.keyframes is not None and self.map.is_growing
        track_objects = fusion.track_objects and self._slam.odometry.is_in_main_map
        if not fuse and not track_objects:
            return None
        return fusion._replace(
            keyframes=fusion.keyframes if fuse else None, track_objects=track_objects
        )

    def _status(self, state: SlamState, result: TrackingResult | None = None) -> SlamStatus:
        stats = self._slam.stats
        return SlamStatus(
            state=state, mode=self.mode,
            message=status_message(state, result, self._slam.odometry.is_in_main_map),
            tracked_points=result.num_tracked if result else 0,
            inliers=result.num_inliers if result else 0,
            keyframes=stats.num_keyframes, map_points=stats.num_map_points, maps=stats.num_maps,
            mapper_queue=self.map.queue_length, loops=stats.num_loops, merges=stats.num_merges,
            relocalizations=stats.num_relocalizations,
            frames_processed=self._num_processed, frames_dropped=self._gaps.num_missing,
            stage_ms=result.stage_ms if result else {},
        )  # fmt: skip
