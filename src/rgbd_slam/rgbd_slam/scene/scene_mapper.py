"""The scene mapper: dense map, floor, grid, people and objects from images with known poses."""

from __future__ import annotations

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    DynamicObject,
    Float32Array,
    FloatArray,
    IntArray,
)
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.scene.floor import Floor, find_floor
from rgbd_slam.scene.grid import Grid, project_grid, require_free_space
from rgbd_slam.scene.object_sighting import DepthImage
from rgbd_slam.scene.object_tracker import ObjectTracker, TrackedObject
from rgbd_slam.scene.scene_ledger import SceneLedger
from rgbd_slam.scene.scene_scheduler import SceneRequest
from rgbd_slam.scene.voxel_map import ColoredCloud, VoxelMap, in_boxes

_UP = np.array([0.0, 0.0, 1.0])


class SceneMapper:
    """Maps the scene in the map frame, whose z axis points up.

    Each image comes with a `SceneRequest`, which has its time, pose and keyframe, the same for all
    maps. Those that describe the static scene are made of the images in the `ledger`, which knows
    what was integrated where; another one is added to its consumers. The grid is projected from
    the voxels whenever it is asked for. Tracks of people and objects describe the present: they
    are updated once per image, and no later correction of the map changes them.

    Args:
        camera: The camera of depth and color.
        dense: Parameters of the dense map.
        objects: Parameters of the object tracks.
        is_map_level: Whether the map frame is level to within a degree or two, as it is when the
            base frame is known. The grid has the map's x and y then; otherwise it has a level
            frame of its own.
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
        self._voxels = VoxelMap(camera, dense)
        self.ledger = SceneLedger((self._voxels,), dense)
        self._tracker = ObjectTracker(objects)
        self._is_map_level = is_map_level
        self._floor: Floor | None = None

    def reconfigure(self, dense: DenseConfig) -> bool:
        """Apply the parameters that may change at run time; return whether the grid changes."""
        is_other_grid = dense.grid != self._config.grid
        self._config = dense
        return is_other_grid

    @property
    def num_voxels(self) -> int:
        """Return the number of voxels of the dense map."""
        return len(self._voxels)

    def fuse(
        self,
        request: SceneRequest,
        depth_m: Float32Array,
        image_bgr: ByteArray,
        objects: tuple[DynamicObject, ...],
    ) -> None:
        """Integrate an image (H, W) into the dense map.

        Pixels in the boxes of dynamic objects add no surface, but the space in front of them is
        still carved.
        """
        boxes = [seen.box_xyxy_px for seen in objects if seen.is_dynamic]
        boxes_xyxy_px = np.array(boxes, np.float32).reshape(-1, 4)
        is_dynamic = in_boxes(depth_m.shape, boxes_xyxy_px, self._config.mask_margin_px)
        self.ledger.add(request, self._voxels.view_of(depth_m, is_dynamic, image_bgr))

    def track_objects(
        self, request: SceneRequest, depth_m: Float32Array, objects: tuple[DynamicObject, ...]
    ) -> tuple[TrackedObject, ...]:
        """Update the tracks with an image (H, W), and return the confirmed ones."""
        image = DepthImage.of(self._camera, depth_m, request.T_map_camera)
        return self._tracker.update(objects, image, request.stamp_ns, self._floor)

    def load(self, dense: DenseState, keyframes: KeyframePoses, keyframe_uids: IntArray) -> None:
        """Add a saved dense map.

        Args:
            dense: The dense map.
            keyframes: The present poses of all keyframes, those of the saved map included.
            keyframe_uids: (K,) uids of the keyframes that were saved with the dense map.

        Raises:
            MapFileError: It was made with another `pixel_stride`.
        """
        if not dense.fits(self._camera, self._config.pixel_stride):
            raise MapFileError('the dense map was made with another dense.pixel_stride')
        self.ledger.correct(keyframes)
        for view in dense.views(keyframe_uids):
            self.ledger.restore(view)

    def cloud(self) -> ColoredCloud:
        """Return the confirmed points of the dense map, in the map frame."""
        return self._voxels.cloud()

    def grid(self, cloud: ColoredCloud) -> Grid | None:
        """Return the grid of the dense map's cloud, or None while no floor has been seen.

        This also finds the floor, on which tracked people stand from then on.
        """
        points_m = cloud.points_m.astype(np.float64)
        self._floor = find_floor(points_m, _UP) or self._floor
        if self._floor is None:
            return None
        floor, config = self._floor, self._config.grid
        T_map_level = floor.T_map_ground if self._is_map_level else floor.T_map_floor
        grid = project_grid(points_m, T_map_level, config, self._voxels.unconfirmed_m())
        return require_free_space(grid, config, self._is_free)

    def _is_free(self, points_m: FloatArray) -> BoolArray:
        """Return the (N,) mask of the points (N, 3) that one of the stored images sees through."""
        is_free = np.zeros(len(points_m), np.bool_)
        for view, T_map_camera in self.ledger.integrated():
            left = np.flatnonzero(~is_free)
            if len(left) == 0:
                break
            is_free[left] = self._voxels.sees_through(points_m[left], view, T_map_camera)
        return is_free
