"""The scene mapper: dense map, floor, grid, people and objects from images with known poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import (
    ByteArray,
    CameraModel,
    Detections,
    DynamicObject,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.object_config import ObjectMapConfig, ObjectTrackerConfig
from hoid_scene.dense.cloud_labels import NO_CLASS, CloudLabels
from hoid_scene.dense.dense_map import DenseMap
from hoid_scene.dense.depth_view import in_boxes
from hoid_scene.dense.submap import ColoredCloud, Submap, transform
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.dense.view_store import ViewStore
from hoid_scene.grid.floor import ON_FLOOR_M, Floor, find_floor
from hoid_scene.grid.free_space import mark_free_space
from hoid_scene.grid.grid import Grid, SubmapCells, cells_of, compose_grid
from hoid_scene.grid.local_floors import LocalFloors
from hoid_scene.level.upright import find_upright
from hoid_scene.level.upright_box import Level
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.objects.object_map import ObjectMap
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.search.rooms import Rooms, find_rooms
from hoid_scene.tracks.object_sighting import DepthImage
from hoid_scene.tracks.object_track import TrackedObject
from hoid_scene.tracks.object_tracker import ObjectTracker

_UP = np.array([0.0, 0.0, 1.0])
# Chosen: the level is found again when the number of images has grown by this factor.
_LEVEL_GROWTH = 1.2
_MAX_CAMERAS = 256  # chosen: enough to show how the camera is carried
_FLOOR_POINTS = 50_000  # chosen: about so many points of the cloud are used to find the floor
# Chosen, less than half a voxel: the old floor is kept if the new one differs by less, because
# `LocalFloors` corrects small differences.
_SAME_FLOOR_M = 0.01


class SceneMapper:
    """Maps the scene in the map frame, whose z axis points up.

    Each image comes with a `SceneRequest`, which gives its time, pose and keyframe for all maps.
    Tracks of people and objects describe the present: images update them, and no later correction
    of the map changes them.

    Attributes:
        dense: The static scene. The grid is composed of the cells below its submaps; only submaps
            that have changed are projected again.
        object_map: The objects at rest; None: the object map is off.

    Args:
        object_map: Parameters of the object map; if not enabled, there is none.
        views: Store of the images of the dense map, which is empty; None: a temporary one.
    """

    def __init__(
        self,
        camera: CameraModel,
        dense: DenseConfig,
        objects: ObjectTrackerConfig,
        object_map: ObjectMapConfig = ObjectMapConfig(),  # noqa: B008 - immutable
        *,
        is_map_level: bool = False,
        views: ViewStore | None = None,
    ) -> None:
        self.camera, self._is_map_level = camera, is_map_level
        self._config = dense
        self.dense = DenseMap(camera, dense, views)
        self._tracker = ObjectTracker(objects)
        self._tracks: tuple[TrackedObject, ...] = ()  # tracks after the last image
        self.object_map = ObjectMap(camera, object_map.prior_score) if object_map.enabled else None
        self._is_prior, self._is_labeled = object_map.prior_score > 0, object_map.label_cloud
        self._floors: LocalFloors | None = None
        self._level = Level(_UP)
        self._num_fused = self._num_leveled = 0  # fused images, now and when the level was found
        # The cells below each submap, and the key for which they are valid.
        self._cells: dict[Submap, tuple[tuple[object, ...], SubmapCells]] = {}

    def reconfigure(self, dense: DenseConfig) -> bool:
        """Apply the parameters of the dense map that may change at run time.

        Return whether parameters of the grid differ from those before.
        """
        is_other_grid = dense.grid != self._config.grid
        self._config = dense
        return is_other_grid

    @property
    def is_map_level(self) -> bool:
        """Return whether the map frame is level within about 2 degrees, by base or gravity.

        If so, the grid has the x and y of the map frame; otherwise it has a frame of its own,
        which is level with the floor.
        """
        return self._is_map_level

    @is_map_level.setter
    def is_map_level(self, is_level: bool) -> None:
        if is_level != self._is_map_level:
            self._is_map_level, self._level, self._floors = is_level, Level(_UP), None
            self._num_leveled = 0

    @property
    def floor(self) -> Floor | None:
        """Return the floor that `grid` or `label` has found; without a floor there is no grid."""
        return None if self._floors is None else self._floors.floor

    def use(
        self,
        request: SceneRequest,
        depth_m: Float32Array,
        image_bgr: ByteArray,
        objects: tuple[DynamicObject, ...],
    ) -> None:
        """Use an image for the maps that it was requested for; see the next three methods."""
        if request.track_objects:
            self.track_objects(request, depth_m, objects)
        self.map_objects(request, depth_m, objects, lambda: image_bgr)
        if request.fuse:
            self.fuse(request, depth_m, image_bgr, objects)

    def track_objects(
        self, request: SceneRequest, depth_m: Float32Array, objects: tuple[DynamicObject, ...]
    ) -> tuple[TrackedObject, ...]:
        """Update the tracks with an image, and return the confirmed tracks by id.

        If the image is for other maps as well, this must be called first.
        """
        image = DepthImage.of(self.camera, depth_m, request.T_map_camera)
        self._tracks = self._tracker.update(objects, image, request.stamp_ns, self.floor)
        return self._tracks

    def map_objects(
        self,
        request: SceneRequest,
        depth_m: Float32Array,
        objects: tuple[DynamicObject, ...],
        color: Callable[[], ByteArray] | None = None,
    ) -> bool:
        """Update the object map, if it is on and due, with an image and the latest tracks.

        Its objects must be detected, not all predicted (`SceneScheduler.narrow`). Return whether
        the image was used. `color` returns the color image (H, W, 3); without it, objects get no
        colors or pictures.
        """
        if self.object_map is None or not request.map_objects:
            return False
        image = DepthImage.of(self.camera, depth_m, request.T_map_camera)
        judged = self._tracker.judged(objects, image, request.stamp_ns)
        return self.object_map.update(request, depth_m, judged, self._tracks, color)

    def fuse(
        self,
        request: SceneRequest,
        depth_m: Float32Array,
        image_bgr: ByteArray,
        objects: tuple[DynamicObject, ...],
    ) -> None:
        """Integrate an image (H, W) into the dense map.

        Pixels in or near the boxes of dynamic objects add no surface, but voxels in front of the
        surface that they show are removed (carved). Tracks decide which objects are dynamic: the
        filter may call them handled for seconds after they were put down, or as long as a person
        is near. The image is ignored if its keyframe does not exist any more. MapFileError if the
        image cannot be stored.
        """
        image = DepthImage.of(self.camera, depth_m, request.T_map_camera)
        judged = self._tracker.judged(objects, image, request.stamp_ns)
        boxes = [item.box_xyxy_px for item in judged if item.is_dynamic]
        boxes_xyxy_px = np.array(boxes, np.float32).reshape(-1, 4)
        is_dynamic = in_boxes(depth_m.shape, boxes_xyxy_px, self._config.mask_margin_px)
        self._num_fused += 1
        self.dense.add(request, self.dense.camera.view_of(depth_m, is_dynamic, image_bgr))

    def mapped_objects(self, *, tentative: bool = False) -> tuple[MapObject, ...]:
        """Return the objects of the main map by id; none if the object map is off."""
        if self.object_map is None:
            return ()
        if self._num_fused > _LEVEL_GROWTH * self._num_leveled:
            self._update_floor(self.cloud())
        return self.object_map.objects(self.floor, self._level, tentative=tentative)

    def rooms(self, objects: Sequence[MapObject]) -> Rooms | None:
        """Return the rooms of the dense map, named by these objects; None without a grid."""
        cloud = self.cloud()
        grid = self.grid(cloud) if len(cloud.points_m) else None
        if grid is None or grid.cells.size == 0:
            return None
        return Rooms(find_rooms(grid, cloud.points_m), grid, objects)

    def expected_objects(self) -> Detections | None:
        """Return the expected boxes of known objects in the latest image for the object map.

        None is returned before the first image, and if `object_map.prior_score` is 0.
        """
        if self.object_map is None or not self._is_prior:
            return None
        return self.object_map.expected

    def correct(self, keyframes: KeyframePoses, *, force: bool = False) -> None:
        """Apply corrected keyframe poses to the dense map and the object map."""
        self.dense.correct(keyframes, force=force)
        if self.object_map is not None:
            self.object_map.correct(keyframes)

    def load(self, dense: SubmapState, keyframes: KeyframePoses, keyframe_uids: IntArray) -> None:
        """Add a saved dense map to the dense map, after the keyframe poses were applied."""
        if dense.voxel_m[0] != self._config.voxel_m:
            voxel_m = dense.voxel_m[0]
            raise MapFileError(f'the dense map was made with dense.voxel_m {voxel_m:g}: set this')
        self.correct(keyframes)
        self.dense.load(dense, keyframe_uids)

    def cloud(self) -> ColoredCloud:
        """Return the confirmed points of the dense map (main map only), in the map frame."""
        return self.dense.cloud()

    def label(self, cloud: ColoredCloud) -> CloudLabels | None:
        """Return the classes of the points of a cloud of the dense map; the floor has none.

        None is returned if `object_map.label_cloud` is false, or if there is no object map. If no
        floor is known, it is searched for in the cloud first.
        """
        if self.object_map is None or not self._is_labeled:
            return None
        if self._floors is None:
            self._update_floor(cloud)
        found = self.object_map.label(cloud.points_m)
        if self.floor is not None:
            heights_m = self.floor.distances_m(cloud.points_m.astype(np.float64))
            found.labels[heights_m < ON_FLOOR_M] = NO_CLASS
        return found

    def grid(self, cloud: ColoredCloud) -> Grid | None:
        """Return the grid of the dense map, or None while no floor has been found.

        This also updates the floor, which is used to measure people and furniture as well, and the
        free space that the images have seen. `cloud` is the present result of `cloud()`.
        """
        self._update_floor(cloud)
        if self._floors is None:
            return None
        floor, config = self._floors.floor, self._config.grid
        T_map_level = floor.T_map_ground if self.is_map_level else floor.T_map_floor
        submaps = self.dense.shown()
        floor_m = self._floors.heights_m(submaps)
        mark_free_space(submaps, floor, floor_m, self.dense.camera, self.dense.read)
        before, self._cells = self._cells, {}
        for submap in submaps:
            key = submap.revision, floor_m[submap], config
            known = before.get(submap)
            if known is None or known[0] != key:
                known = key, self._cells_of(submap, T_map_level, floor_m[submap])
            self._cells[submap] = known
        return compose_grid([cells for _, cells in self._cells.values()], T_map_level, config)

    def _cells_of(self, submap: Submap, T_map_level: FloatArray, floor_m: float) -> SubmapCells:
        T_level_submap = np.linalg.inv(T_map_level) @ submap.T_map_submap
        points_m = transform(T_level_submap, submap.points_m())
        points_m[:, 2] -= floor_m
        free = submap.free_above.reshape(-1)[submap.columns()]
        return cells_of(points_m, submap.is_shown(), free, self._config.grid)

    def _update_floor(self, cloud: ColoredCloud) -> None:
        """Find the floor in a cloud, and the direction up first if the map frame is not level.

        The old floor stays if none is found, if the surfaces do not show which direction is up, or
        if the new floor is less than 1 cm from it at all points. A new floor moves the level frame
        of the grid and the steps of height above it, so that all submaps are projected into the
        grid again.
        """
        self._num_leveled = self._num_fused
        cameras = self._cameras()
        if len(cloud.points_m) == 0 or len(cameras) == 0:
            return  # the map has just begun
        step = max(1, len(cloud.points_m) // _FLOOR_POINTS)
        points = cloud.points_m[::step].astype(np.float64)
        known_up = _UP if self.is_map_level else None
        upright = find_upright(cloud.points_m.astype(np.float64), cameras, known_up)
        if upright is not None:
            self._level = Level(upright.up, upright.wall)
        if not self.is_map_level and not (upright is not None and upright.is_certain):
            return
        floor = find_floor(points, self._level.up, is_up_exact=not self.is_map_level)
        if floor is None:
            return
        if self.floor is not None:
            old, new = (f.distances_m(points) for f in (self.floor, floor))
            if np.abs(new - old).max() < _SAME_FLOOR_M:
                return
        self._floors = LocalFloors(floor)
        self._cells.clear()
        for submap in self.dense.submaps:
            submap.marked.clear()

    def _cameras(self) -> FloatArray:
        """Return the poses T_map_camera (K, 4, 4) of keyframes of the main map, at most 256."""
        keyframes = self.dense.keyframes
        poses = keyframes.T_map_camera[keyframes.is_main]
        return poses[:: max(1, -(-len(poses) // _MAX_CAMERAS))]
