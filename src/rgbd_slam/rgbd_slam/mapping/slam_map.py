"""The map of the running SLAM: grows by keyframes, is saved and loaded, has a z-up map frame."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
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
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapping.inline_mapper import InlineMapper
from rgbd_slam.mapping.map_loading import MapLoading
from rgbd_slam.mapping.mapper import KeyframeRequest
from rgbd_slam.mapping.mapper_process import MapperProcess
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.loop_edge import renumbered
from rgbd_slam.model.map_state import snapshot
from rgbd_slam.model.trajectory import TrajectoryRecorder, current_pass, keyframe_poses, main_map
from rgbd_slam.places.place_finder import PlaceFinder
from rgbd_slam.records.soa_table import DEAD
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.store.map_file import MapFile, check_extendable
from rgbd_slam.store.tables import MapHeader


@dataclass(frozen=True)
class SlamStats:
    """Size of the main map (the one with most keyframes), and counts since the start."""

    # In the main map; before the first keyframe is inserted, the number of pending keyframes.
    num_keyframes: int
    num_map_points: int  # number of points in the main map
    # More than one after tracking was lost, or after a saved map was loaded beside the running
    # one, until the maps are merged.
    num_maps: int = 0
    num_loops: int = 0
    num_merges: int = 0
    num_relocalizations: int = 0


class MapPoses(NamedTuple):
    """Copied poses of the K keyframes of the main map, in order of insertion."""

    map_id: int | None  # id of the main map; None: it is the only map
    stamps_ns: IntArray  # (K,)
    is_loaded: BoolArray  # (K,) whether the keyframe comes from a saved map
    T_core_camera: FloatArray  # (K, 4, 4) in the core's map frame


class CopiedPoints(NamedTuple):
    """Copied positions of R successive rows of the map point table."""

    position_m: Float32Array  # (R, 3) in the core's map frame; arbitrary where not shown
    is_shown: BoolArray  # (R,) whether the row holds a point of the map to be shown
    is_last: bool  # True: these are the last rows of the table


class SlamMap:
    """The map of the running SLAM with the mapper that extends it.

    `atlas` has its tables in the core's map frame, the optical frame at the first camera pose;
    methods return poses and points in the robot's map frame (REP 105, z up). With a mapper in
    another process (`background`), `atlas` is the tracker's copy. It changes only in `insert`,
    `update`, `finish` and `load`, so that the caller decides between which images it changes.
    These methods raise MapperStoppedError if the process has failed or does not respond, or if a
    saved map could not be restored.
    """

    def __init__(
        self, camera: CameraModel, config: SlamConfig, frames: RobotFrames, *, background: bool
    ) -> None:
        self.frames, self.stereo = frames, StereoCamera.from_model(camera, config.camera)
        self._camera = self._made_with = camera
        self._config = config
        self._octaves = config.camera.scale_factor, config.camera.num_octaves
        self.atlas = Atlas(*self._octaves)
        self.recorder = TrajectoryRecorder(self.atlas)
        self.places = PlaceFinder(self.atlas, self.stereo, config.places, config.seed)
        self.mapper: MapperProcess | InlineMapper = (
            MapperProcess(self.stereo, self.atlas, config)
            if background
            else InlineMapper(self.stereo, self.atlas, config)
        )
        self.is_growing = True  # False: localization, in which no keyframe is inserted
        # Name of the map; a map that replaces it gets a new one.
        self.session = secrets.token_hex(8)
        # True: the map has changed in a way that `consume_change` cannot detect.
        self.has_changed = False
        self._last_state: object = None  # state of the map at the last `consume_change`
        self._loading: MapLoading | None = None
        self._on_loaded: Callable[[], None] = _ignore
        # Called when a saved map has replaced the running map.
        self.on_replaced: Callable[[], None] = _ignore
        self._next_map_id = 0  # id of the next map; the id of a merged map is not used again
        self._next_uid = 0  # uid of the next keyframe

    @property
    def is_empty(self) -> bool:
        """Return whether the map has no keyframe, not even a pending one."""
        return len(self.atlas.keyframes) == 0 and not self.atlas.pending

    @property
    def takes_keyframes(self) -> bool:
        """Return whether keyframes may be inserted: not in localization, nor before a new map."""
        is_leaving = self._loading is not None and not self._loading.keeps_running
        return self.is_growing and not is_leaving

    @property
    def is_loading(self) -> bool:
        return self._loading is not None

    # ---- growing

    def start(self, frame: Frame, T_map_camera: FloatArray) -> int:
        """Start another map beside the existing ones; return the uid of its first keyframe."""
        uid = self.reserve_uids(1)
        self.mapper.start_map(uid, frame, T_map_camera, self._next_map_id)
        self._next_map_id += 1
        return uid

    def reserve_uids(self, count: int) -> int:
        """Reserve `count` successive uids for new keyframes, and return the first of them.

        A keyframe gets its uid before the mapper inserts it, so that frames can refer to it.
        """
        self._next_uid += count
        return self._next_uid - count

    def insert(self, request: KeyframeRequest) -> None:
        """Send a keyframe to the mapper; it is in `atlas.pending` until it is mapped."""
        self.mapper.insert(request)
        self.update()

    def update(self) -> None:
        """Apply the changes that the mapper has finished, without waiting for others."""
        self.mapper.update()
        self.recorder.redirect(self.atlas.redirects.take())
        if self._loading is not None and not self.mapper.is_loading:
            self._use_loaded(self._loading)

    def finish(self) -> None:
        """Wait for all keyframes and for a final global adjustment, up to its time limit."""
        self.mapper.finish()
        self.update()

    # ---- reading, in the robot's map frame

    def stats(self, num_relocalizations: int) -> SlamStats:
        keyframes, points, loops = self.atlas.keyframes, self.atlas.points, self.mapper.loops
        sizes, main = np.bincount(keyframes.map_id[keyframes.alive]), main_map(keyframes)
        num_maps = int(np.count_nonzero(sizes))
        is_in_main = points.alive & (points.map_id == main) if num_maps > 1 else None
        return SlamStats(
            int(sizes[main]) if num_maps else len(self.atlas.pending),
            len(points) if is_in_main is None else int(np.count_nonzero(is_in_main)),
            num_maps,
            loops.closed,
            loops.merged,
            num_relocalizations,
        )

    def consume_change(self) -> bool:
        """Return whether the map has changed since the last call; True for the first call."""
        atlas = self.atlas
        sizes = len(atlas.keyframes), len(atlas.points), len(atlas.pending)
        state = atlas.version, sizes, self.mapper.loops  # each applied report has a new version
        changed = self.has_changed or state != self._last_state
        self.has_changed, self._last_state = False, state
        return changed

    @property
    def pose_version(self) -> tuple[str, int, bytes]:
        """Return a value that changes whenever a keyframe's pose in the map frame changes."""
        return self.session, self.atlas.version, self.frames.T_map_core.tobytes()

    def keyframes(self) -> KeyframePoses:
        """Return the keyframe poses of all maps; those of the main map are in the map frame."""
        poses = keyframe_poses(self.atlas)
        return poses._replace(T_map_camera=self.frames.T_map_core @ poses.T_map_camera)

    def points_m(self) -> FloatArray:
        """Return the points (N, 3) in m of the main map, in the map frame."""
        points = self.atlas.points
        is_main = points.map_id == main_map(self.atlas.keyframes)
        position_m = points.position_m[points.alive & is_main]
        return se3.transform(self.frames.T_map_core, position_m)

    def copy_poses(self) -> MapPoses:
        """Copy the keyframe poses of the main map, for `path_of` and `cameras_of`."""
        keyframes = self.atlas.keyframes
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
        """Copy up to `count` rows of the point table from `first` on, to the last shown point.

        A large map is copied in parts between images, because copying it at once would delay an
        image. Points of the map with id `map_id` are shown; None: of all maps. `shown_points_m`
        converts the copy, in any thread.
        """
        points, rows = self.atlas.points, slice(first, first + count)
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
        """Return T_map_base at this session's keyframes since the stamps last went back."""
        is_own = ~poses.is_loaded
        path = current_pass(Trajectory(poses.stamps_ns[is_own], poses.T_core_camera[is_own]))
        T_map_base = self.frames.T_map_core @ path.T_world_camera @ self.frames.T_camera_base
        return Trajectory(path.stamps_ns, T_map_base)

    def cameras_of(self, poses: MapPoses) -> FloatArray:
        """Return T_map_camera (K, 4, 4) of copied keyframes."""
        return self.frames.T_map_core @ poses.T_core_camera

    def shown_points_m(self, rows: CopiedPoints) -> Float32Array:
        """Return the points (N, 3) in m that are to be shown, in the map frame."""
        T_map_core = self.frames.T_map_core.astype(np.float32)
        shown_m = rows.position_m.take(np.flatnonzero(rows.is_shown), axis=0)
        return shown_m @ T_map_core[:3, :3].T + T_map_core[:3, 3]

    def trajectory(self, kind: str) -> Trajectory:
        """Return the camera trajectory T_map_camera of a kind: `final`, `online` or `keyframes`.

        Online poses were estimated when the images arrived. Final poses follow from the present
        map; call `finish` before. ConfigError for another kind; InputError if the file with old
        poses cannot be read.
        """
        return Trajectory.joined(self.trajectory_parts(kind))

    def trajectory_parts(self, kind: str) -> Iterator[Trajectory]:
        """Return the trajectory of a kind in parts, over which any thread may iterate."""
        # An adjustment before final poses are read moves keyframes, but changes none of the
        # counts.
        self.has_changed |= kind == 'final'
        return map(self.frames.cameras, self.recorder.parts(kind))

    # ---- saving and loading

    def export(self) -> MapFile:
        """Return a copy of the map for a file (0.04 ms per keyframe); ConfigError if empty."""
        atlas = self.atlas
        if len(atlas.keyframes) == 0:
            raise ConfigError('nothing has been mapped yet: there is nothing to save')
        state = snapshot(atlas).moved(self.frames.T_map_core)
        uids = keyframe_poses(atlas).uids
        loops = renumbered(atlas.loops, {uid: uid for uid in uids.tolist()})
        return MapFile(self._camera, *self._octaves, state, uids, loops, self.session)

    def header(self, stamp_ns: int) -> MapHeader:
        T_map_core = self.frames.T_map_core
        return MapHeader(self._camera, *self._octaves, T_map_core, self.session, stamp_ns)

    def check_extendable(self) -> None:
        """Raise MapFileError if the camera differs too much from the map's to extend the map."""
        check_extendable(self._made_with, self._camera)

    def prepare_load(
        self, content: MapFile, *, keep: bool = False, extend: bool = True
    ) -> MapLoading:
        """Prepare a saved map for `begin_load`, in any thread.

        The map frame is not leveled any more, because it becomes that of the saved map.

        Args:
            content: The saved map.
            keep: True: continue in the running map until a place of the saved map is recognized.
                False: discard the running map, and relocalize the camera in the saved map.
            extend: True: the map will be extended; False: only localization.

        Raises:
            MapFileError: The octaves of the features differ, or the camera differs too much to
                extend the map.
        """
        state = content.seen_by(self._camera, *self._octaves, extend=extend).map
        self.frames.is_fixed = True
        return MapLoading(
            state.moved(se3.inverse(self.frames.T_map_core)),
            self.stereo,
            self._config,
            running=self.atlas if keep else None,
            loops=content.loops_by_row,
            places=self.places,
            made_with=content.camera,
        )

    def begin_load(self, loading: MapLoading, on_loaded: Callable[[], None]) -> None:
        """Start loading a saved map, while the running one continues.

        Another thread must call `loading.restore`. A later `update` then exchanges the maps
        between two images, and calls `on_loaded`. A mapper in this process needs no other thread.
        The mapper must be settled if the running map is kept; otherwise the running map gets no
        new keyframes.
        """
        loading.first_uid = self.reserve_uids(len(loading))
        self._loading, self._on_loaded = loading, on_loaded
        self.mapper.begin_load(loading)

    def load(self, content: MapFile, *, extend: bool = True) -> IntArray:
        """Replace the map by a saved one; return the uids (K,) of its keyframes.

        MapFileError if the saved map does not fit (`prepare_load`); the running one then stays.
        """
        loading = self.prepare_load(content, extend=extend)
        self.finish_load(loading)
        return loading.uids

    def finish_load(self, loading: MapLoading) -> None:
        self.begin_load(loading, _ignore)
        self.mapper.finish_load(loading)
        self.update()

    def _use_loaded(self, loading: MapLoading) -> None:
        keyframes = self.atlas.keyframes
        self._next_map_id = 1 + int(keyframes.map_id[keyframes.alive].max())
        if loading.index is not None:
            self.places.use_index(loading.index)
        self._loading, self.has_changed = None, True
        self._made_with = loading.made_with or self._made_with
        self.frames.take_saved()
        if not loading.keeps_running:
            self.session = secrets.token_hex(8)
            self.on_replaced()
        self._on_loaded()


def _ignore() -> None:
    pass
