"""The running map in the robot's map frame, as it is published, saved and loaded."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import (
    BoolArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
    Trajectory,
)
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.model.loop_edge import renumbered
from rgbd_slam.model.map_state import snapshot
from rgbd_slam.model.trajectory import current_pass, keyframe_poses, main_map
from rgbd_slam.processes.map_loading import MapLoading
from rgbd_slam.records.soa_table import DEAD
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.statistics import SlamStats
from rgbd_slam.store.map_file import MapFile, check_extendable
from rgbd_slam.store.tables import MapHeader


class LoadedMap(NamedTuple):
    """The keyframes after a saved map was loaded: which ones came from it, and all poses."""

    keyframe_uids: IntArray  # (K,) new uids of the saved keyframes, in the order of the saved map
    # All keyframes, also those of a running map that was kept. Poses of the main map are in the
    # map frame.
    keyframes: KeyframePoses


class MapPoses(NamedTuple):
    """Copied poses of the K keyframes of the main map in order of insertion, in the core's frame.

    `RobotFrames.T_map_core` leads from the core's map frame to the robot's map frame.
    """

    map_id: int | None  # id of the main map; None: it is the only map
    stamps_ns: IntArray  # (K,)
    is_loaded: BoolArray  # (K,) whether the keyframe is from a saved map
    T_core_camera: FloatArray  # (K, 4, 4)


class CopiedPoints(NamedTuple):
    """Copied positions of R successive rows of the table of map points, in the core's map frame.

    `RobotFrames.T_map_core` leads from the core's map frame to the robot's map frame.
    """

    position_m: Float32Array  # (R, 3), without meaning in rows that are not shown
    is_shown: BoolArray  # (R,) whether the row holds a point of the map to be shown
    is_last: bool  # True: these are the last rows of the table


class PreparedMap(NamedTuple):
    """A saved map that is ready to be loaded."""

    loading: MapLoading
    made_with: CameraModel  # the camera that the map was made with


class RobotMap:
    """Reads the map of `slam` in the robot's map frame (REP 105, z up), and replaces it.

    Args:
        slam: The running SLAM, whose poses are in the core's map frame.
        frames: Where the camera is mounted on the robot.
        camera: The camera.
        config: Parameters of the camera and its features.
    """

    def __init__(
        self, slam: RgbdSlam, frames: RobotFrames, camera: CameraModel, config: CameraConfig
    ) -> None:
        self._slam, self.frames = slam, frames
        self._camera, self._config = camera, config
        # Whether the map has changed since `take_change` in a way that neither the statistics nor
        # the version of the atlas show.
        self.has_changed = False
        # Name of the map, a new one whenever it is replaced.
        self.session = secrets.token_hex(8)
        self._made_with = camera  # the camera that the map was made with
        self._last_state: tuple[SlamStats, int] | None = None

    def take_change(self) -> bool:
        """Return whether the map has changed since the last call; True at the first call.

        Changes of the statistics, new keyframes, loaded maps, turns of the map frame, and poses
        and points that the process of the mapper has changed are noticed.
        """
        state = self._slam.stats, self._slam.map.atlas.version  # grows with each applied report
        changed = self.has_changed or state != self._last_state
        self.has_changed, self._last_state = False, state
        return changed

    @property
    def pose_version(self) -> tuple[str, int, bytes]:
        """Return a value that differs after each change of a keyframe's pose in the map frame."""
        return self.session, self._slam.map.atlas.version, self.frames.T_map_core.tobytes()

    def check_extendable(self) -> None:
        """Raise MapFileError if the camera differs too much from that of the map to extend it."""
        check_extendable(self._made_with, self._camera)

    def keyframes(self) -> KeyframePoses:
        """Return the keyframe poses of all maps; those of the main map are in the map frame.

        The poses of other maps are in frames whose relation to the map frame is unknown.
        """
        return self.frames.keyframes(keyframe_poses(self._slam.map.atlas))

    def points_m(self) -> FloatArray:
        """Return the (N, 3) points [m] of the main map, in the map frame."""
        points = self._slam.map.atlas.points
        is_main = points.map_id == main_map(self._slam.map.atlas.keyframes)
        return self.frames.points_m(points.position_m[points.alive & is_main])

    def copy_poses(self) -> MapPoses:
        """Copy the keyframe poses of the main map between two images.

        `path_of` and `cameras_of` convert the copy, in any thread.
        """
        keyframes = self._slam.map.atlas.keyframes
        map_id, rows = main_map(keyframes), keyframes.indices_by_uid()
        is_main = keyframes.map_id[rows] == map_id
        rows = rows[is_main]
        return MapPoses(
            None if is_main.all() else map_id,
            keyframes.stamp_ns[rows],
            keyframes.is_loaded[rows],
            keyframes.T_map_camera[rows],
        )

    def copy_points(self, map_id: int | None, first: int, count: int) -> CopiedPoints:
        """Copy `count` rows of the table of points, without those after the last shown point.

        A large map is copied part by part between images, because copying it at once would delay
        an image. `shown_points_m` converts the copy, in any thread.

        Args:
            map_id: Id of the map whose points are shown; None: those of all maps.
            first: The first row.
            count: Number of rows, of which those beyond the end of the table are left out.
        """
        points, rows = self._slam.map.atlas.points, slice(first, first + count)
        is_shown = points.uid[rows] != DEAD
        if map_id is not None:
            is_shown &= points.map_id[rows] == map_id
        num_used = len(is_shown) - int(is_shown[::-1].argmax()) if is_shown.any() else 0
        return CopiedPoints(
            points.position_m[first : first + num_used].astype(np.float32),
            is_shown[:num_used],
            first + count >= points.capacity,
        )

    def path_of(self, poses: MapPoses) -> Trajectory:
        """Return the poses T_map_base of the robot's base at this session's keyframes.

        Only keyframes since the stamps last jumped back are included; their stamps increase.
        """
        is_own = ~poses.is_loaded
        path = current_pass(Trajectory(poses.stamps_ns[is_own], poses.T_core_camera[is_own]))
        return self.frames.bases(path)

    def cameras_of(self, poses: MapPoses) -> FloatArray:
        """Return the copied keyframe poses as T_map_camera (K, 4, 4), in the robot's map frame."""
        return self.frames.T_map_core @ poses.T_core_camera

    def shown_points_m(self, rows: CopiedPoints) -> Float32Array:
        """Return the (N, 3) shown points [m] of copied rows, in the robot's map frame."""
        T_map_core = self.frames.T_map_core.astype(np.float32)
        shown_m = rows.position_m.take(np.flatnonzero(rows.is_shown), axis=0)
        return shown_m @ T_map_core[:3, :3].T + T_map_core[:3, 3]

    def trajectory(self, kind: str) -> Trajectory:
        """Return the camera poses T_map_camera of a kind: `final`, `online` or `keyframes`.

        Online poses are those that were estimated when the frames arrived, in the present map
        frame. Final poses follow from the current map. They lack frames of maps that are not
        linked with the main one, and frames whose reference keyframe is pending or gone
        (`TrajectoryRecorder.final`). Call `slam.map.finish` before, so that they follow from the
        map after its last adjustment. For the kind `final`, the map counts as changed
        (`take_change`). Keyframes are those of this session in the main map.

        Raises:
            ConfigError: There is no such kind.
        """
        return Trajectory.joined(self.trajectory_parts(kind))

    def trajectory_parts(self, kind: str) -> Iterator[Trajectory]:
        """Return the poses of `trajectory` in parts that any thread may iterate over.

        For the kind `final`, the map counts as changed (`take_change`).

        Raises:
            ConfigError: There is no such kind.
        """
        # The map is adjusted before final poses are read. This moves keyframes but changes no
        # statistics.
        self.has_changed |= kind == 'final'
        return map(self.frames.cameras, self._slam.trajectory.parts(kind))

    def export(self) -> MapFile:
        """Copy the map for a file (0.04 ms per keyframe), in the robot's map frame.

        Raises:
            ConfigError: There is no map.
        """
        atlas, config = self._slam.map.atlas, self._config
        if len(atlas.keyframes) == 0:
            raise ConfigError('nothing has been mapped yet: there is nothing to save')
        state = snapshot(atlas).moved(self.frames.T_map_core)
        octaves, uids = (config.scale_factor, config.num_octaves), keyframe_poses(atlas).uids
        loops = renumbered(atlas.loops, {uid: uid for uid in uids.tolist()})
        return MapFile(self._camera, *octaves, state, uids, loops, self.session)

    def header(self, stamp_ns: int) -> MapHeader:
        """Return the header of the map for a file; `stamp_ns` is that of the latest image."""
        octaves = self._config.scale_factor, self._config.num_octaves
        return MapHeader(self._camera, *octaves, self.frames.T_map_core, self.session, stamp_ns)

    def prepare_load(
        self, content: MapFile, *, keep: bool = False, extend: bool = True
    ) -> PreparedMap:
        """Return a saved map for `begin_load`. Any thread may call this.

        From now on, the map frame is not leveled, because it becomes that of the saved map.

        Args:
            content: The saved map.
            keep: True: continue in the running map until a place of the saved map is recognized.
                False: discard the running map, and relocalize the camera in the saved map.
            extend: Whether the map will be extended, and not only localized in.

        Raises:
            MapFileError: The map was made with a camera that differs too much to extend it, or
                with other features.
        """
        octaves = self._config.scale_factor, self._config.num_octaves
        state = content.seen_by(self._camera, *octaves, extend=extend).map
        self.frames.is_fixed = True
        in_core = state.moved(se3.inverse(self.frames.T_map_core))
        loading = self._slam.prepare_load(in_core, keep=keep)
        loading.loops = content.loops_by_row
        return PreparedMap(loading, content.camera)

    def begin_load(self, prepared: PreparedMap, on_loaded: Callable[[LoadedMap], None]) -> int:
        """Begin to load a saved map; return the uid of its first keyframe.

        The map frame becomes that of the saved map; if the running map is kept, only once a
        recognized place has merged the two maps. Another thread must restore the map with that
        uid; see `SlamMap.begin_load`.

        Args:
            prepared: The saved map. If it keeps the running map, the mapper must be settled.
            on_loaded: Called between two images, when the map has been loaded.
        """

        def loaded(uids: IntArray) -> None:
            self.has_changed = True
            self._made_with = prepared.made_with
            if not prepared.loading.keeps_running:
                self.session = secrets.token_hex(8)
            on_loaded(LoadedMap(uids, self.keyframes()))

        return self._slam.begin_load(prepared.loading, loaded)

    def load(self, content: MapFile, *, extend: bool = True) -> LoadedMap:
        """Replace the map by a saved one between two images, and relocalize the camera in it.

        The map frame becomes that of the saved map.

        Args:
            content: The saved map.
            extend: Whether the map will be extended, and not only localized in.

        Raises:
            MapFileError: The map was made with a camera that differs too much to extend it, or
                with other features; the running map is unchanged.
            MapperStoppedError: As in `SlamMap.finish_load`.
        """
        prepared, found = self.prepare_load(content, extend=extend), list[LoadedMap]()
        first_uid = self.begin_load(prepared, found.append)
        self._slam.map.finish_load(prepared.loading, first_uid)
        return found[0]
