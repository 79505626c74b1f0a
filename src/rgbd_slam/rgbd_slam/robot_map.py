"""The running map in the robot's map frame, as it is published, saved and loaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.values import CameraModel, FloatArray, IntArray, Trajectory
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.map_io.checkpoint_index import MapHeader
from rgbd_slam.map_io.map_file import MapFile, check_extendable
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.model.map_state import MapState, snapshot
from rgbd_slam.model.trajectory import keyframe_poses, main_map
from rgbd_slam.processes.map_loading import MapLoading
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.statistics import SlamStats


class LoadedMap(NamedTuple):
    """The keyframes of a saved map after it was loaded."""

    keyframe_uids: IntArray  # (K,) of the saved keyframes
    keyframes: KeyframePoses  # all keyframes of the running map now, in the map frame


class PreparedMap(NamedTuple):
    """A saved map that is ready to be loaded."""

    loading: MapLoading
    made_with: CameraModel


class RobotMap:
    """Reads the map of `slam` in the robot's map frame (REP 105, z up), and replaces it.

    Args:
        slam: The running SLAM; its map frame is the optical frame of the first camera pose.
        frames: Where the camera is mounted on the robot.
        camera: The camera.
        config: Parameters of the camera and its features.
    """

    def __init__(
        self, slam: RgbdSlam, frames: RobotFrames, camera: CameraModel, config: CameraConfig
    ) -> None:
        self._slam, self._frames = slam, frames
        self._camera, self._config = camera, config
        # Whether the map has changed since `take_change` in a way that the statistics do not show.
        self.has_changed = False
        self._made_with = camera  # the camera of the loaded map, which may be another one
        self._last_stats: SlamStats | None = None

    def take_change(self) -> bool:
        """Return whether the map has changed since the last call."""
        stats = self._slam.stats
        changed = self.has_changed or stats != self._last_stats
        self.has_changed, self._last_stats = False, stats
        return changed

    def check_extendable(self) -> None:
        """Raise MapFileError if the camera differs too much from that of the map to extend it."""
        check_extendable(self._made_with, self._camera)

    def keyframes(self) -> KeyframePoses:
        """Return the keyframe poses of all maps; those of the main map are in the map frame."""
        return self._frames.keyframes(keyframe_poses(self._slam.map.atlas))

    def points_m(self) -> FloatArray:
        """Return the (N, 3) points [m] of the main map, in the map frame."""
        points = self._slam.map.atlas.points
        is_main = points.map_id == main_map(self._slam.map.atlas.keyframes)
        return self._frames.points_m(points.position_m[points.alive & is_main])

    def base_path(self) -> Trajectory:
        """Return the poses T_map_base of the robot's base at the keyframes, by the current map."""
        return self._frames.bases(self._slam.trajectory.keyframes())

    def trajectory(self, kind: str) -> Trajectory:
        """Return the camera poses of a kind: `final`, `online` or `keyframes`.

        Final poses follow from the current map. Call `slam.map.finish` before, so that they follow
        from the map after its last adjustment.

        Raises:
            ConfigError: There is no such kind.
        """
        return Trajectory.joined(self.trajectory_parts(kind))

    def trajectory_parts(self, kind: str) -> Iterator[Trajectory]:
        """Return the poses of `trajectory` in parts that any thread may iterate over."""
        # The map is adjusted before final poses are read. This moves keyframes but changes no
        # statistics.
        self.has_changed |= kind == 'final'
        return map(self._frames.cameras, self._slam.trajectory.parts(kind))

    def export(self) -> MapFile:
        """Copy the map, without a dense one, for a file; takes a few ms.

        Raises:
            ConfigError: There is no map.
        """
        if len(self._slam.map.atlas.keyframes) == 0:
            raise ConfigError('nothing has been mapped yet: there is nothing to save')
        return self.content_of(snapshot(self._slam.map.atlas))

    def content_of(self, state: MapState) -> MapFile:
        """Return the content of a file, without a dense map, for the map in the core's frame."""
        config, state = self._config, state.moved(self._frames.T_map_core)
        return MapFile(self._camera, config.scale_factor, config.num_octaves, state)

    def header(self) -> MapHeader:
        """Return what the map is, beside its rows, for a checkpoint."""
        config = self._config
        return MapHeader(
            self._camera, config.scale_factor, config.num_octaves, self._frames.T_map_core
        )

    def prepare_load(self, content: MapFile, *, extend: bool = True) -> PreparedMap:
        """Return a saved map for `begin_load`. Any thread may call this.

        Args:
            content: The saved map.
            extend: Whether the map will be extended, and not only localized in.

        Raises:
            MapFileError: The map was made with a camera that differs too much to extend it, or
                with other features.
        """
        state = self._in_core(content, extend=extend)
        return PreparedMap(self._slam.prepare_load(state), content.camera)

    def begin_load(self, prepared: PreparedMap, on_loaded: Callable[[LoadedMap], None]) -> int:
        """Begin to replace the map by a saved one; return the uid of its first keyframe.

        The map frame becomes that of the saved map; see `SlamMap.begin_load`.

        Args:
            prepared: The saved map.
            on_loaded: Called between two images, when the map has been replaced.
        """

        def loaded(uids: IntArray) -> None:
            self.has_changed = True
            self._made_with = prepared.made_with
            on_loaded(LoadedMap(uids, self.keyframes()))

        return self._slam.begin_load(prepared.loading, loaded)

    def load(self, content: MapFile, *, keep: bool = False, extend: bool = True) -> LoadedMap:
        """Load a saved map between two images; the map frame becomes that of the saved map.

        Args:
            content: The saved map.
            keep: Continue in the running map until a place of the saved map is recognized.
                Otherwise the running map is discarded, and the camera is relocalized in the saved
                map.
            extend: Whether the map will be extended, and not only localized in.

        Raises:
            MapFileError: The map was made with a camera that differs too much to extend it, or
                with other features; the running map is unchanged.
        """
        uids = self._slam.load(self._in_core(content, extend=extend), keep=keep)
        self.has_changed = True
        self._made_with = content.camera
        return LoadedMap(uids, self.keyframes())

    def _in_core(self, content: MapFile, *, extend: bool) -> MapState:
        """Return a saved map as this camera would have made it, in the core's map frame."""
        octaves = self._config.scale_factor, self._config.num_octaves
        state = content.seen_by(self._camera, *octaves, extend=extend).map
        return state.moved(se3.inverse(self._frames.T_map_core))
