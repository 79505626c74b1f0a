"""All that is known of the room beyond the pose: dense map, floor, grid, people and objects."""

from __future__ import annotations

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.values import ByteArray, CameraModel, DynamicObject, Float32Array, IntArray
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.dense_mapper import DenseMapper, StoredView
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.scene.floor import Floor, find_floor
from rgbd_slam.scene.fusion_scheduler import FusionRequest
from rgbd_slam.scene.grid import Grid, project_grid, without_unseen
from rgbd_slam.scene.object_sighting import DepthScene
from rgbd_slam.scene.object_tracker import ObjectTracker, TrackedObject
from rgbd_slam.scene.voxel_map import ColoredCloud

_UP = np.array([0.0, 0.0, 1.0])


class SceneMapper:
    """Looks at posed images; the map frame has z up.

    Args:
        camera: Of depth and colour.
        dense: Parameters of the dense map.
        objects: Parameters of the object tracks.
        is_map_level: Whether the map frame is known to be level, but for a degree or two: the grid
            keeps its x and y then, and has a level frame of its own otherwise.
    """

    def __init__(
        self,
        camera: CameraModel,
        dense: DenseConfig,
        objects: ObjectTrackerConfig,
        *,
        is_map_level: bool = False,
    ) -> None:
        self._camera = camera
        self._config = dense
        self._mapper = DenseMapper(camera, dense)
        self._tracker = ObjectTracker(objects)
        self._is_map_level = is_map_level
        self._floor: Floor | None = None

    def reconfigure(self, dense: DenseConfig) -> bool:
        """Take over what may change at run time; return whether the grid is another one now."""
        changes = dense.grid != self._config.grid
        self._config = dense
        return changes

    @property
    def num_voxels(self) -> int:
        """Return the size of the dense map."""
        return len(self._mapper)

    def fuse(
        self,
        pose: FusionRequest,
        depth_m: Float32Array,
        image_bgr: ByteArray,
        objects: tuple[DynamicObject, ...],
    ) -> None:
        """Add an image (H, W) to the dense map, without the dynamic ones of its objects."""
        boxes = [seen.box_xyxy_px for seen in objects if seen.is_dynamic]
        self._mapper.add(pose, depth_m, image_bgr, np.array(boxes, np.float32).reshape(-1, 4))

    def track_objects(
        self, pose: FusionRequest, depth_m: Float32Array, objects: tuple[DynamicObject, ...]
    ) -> tuple[TrackedObject, ...]:
        """Return the people and objects known after an image (H, W)."""
        scene = DepthScene.of(self._camera, depth_m, pose.T_map_camera)
        return self._tracker.update(objects, scene, pose.stamp_ns, self._floor)

    def update_keyframes(self, keyframes: KeyframePoses) -> None:
        """Take the keyframes as the map says now."""
        self._mapper.correct(keyframes)

    def views(self) -> tuple[StoredView, ...]:
        """Return the images of which the dense map is fused, as they hang on known keyframes."""
        return self._mapper.views

    def restore(self, view: StoredView) -> None:
        """Add an image to the dense map that hangs on a known keyframe."""
        self._mapper.restore(view)

    def load(self, dense: DenseState, keyframes: KeyframePoses, keyframe_uids: IntArray) -> None:
        """Add a saved dense map; (K,) uids of the keyframes that were saved with it.

        Raises:
            MapFileError: It was made with another `pixel_stride`.
        """
        if not dense.fits(self._camera, self._config.pixel_stride):
            raise MapFileError('the dense map was made with another dense.pixel_stride')
        self.update_keyframes(keyframes)
        for view in dense.views(keyframe_uids):
            self.restore(view)

    def settle(self, keyframes: KeyframePoses) -> None:
        """Fuse all kept images anew by the keyframes as the map says in the end."""
        self._mapper.correct(keyframes, settle=True)

    def cloud(self) -> ColoredCloud:
        """Return the dense map's points."""
        return self._mapper.cloud()

    def grid(self, cloud: ColoredCloud) -> Grid | None:
        """Return the grid over the floor of a cloud of this room; None while no floor is seen."""
        points_m = cloud.points_m.astype(np.float64)
        self._floor = find_floor(points_m, _UP) or self._floor
        if self._floor is None:
            return None
        floor, config = self._floor, self._config.grid
        T_map_level = floor.T_map_ground if self._is_map_level else floor.T_map_floor
        grid = project_grid(points_m, T_map_level, config, self._mapper.doubtful_m())
        return without_unseen(grid, config, self._mapper.is_clear)
