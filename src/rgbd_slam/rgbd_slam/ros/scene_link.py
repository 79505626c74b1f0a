"""The room mapper beside the SLAM node: started with it when wanted, and missed when it ends."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.values import CameraModel
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.map_transfer import LoadedMap
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.ros.scene_process import SceneProcess
from rgbd_slam.ros.scene_setup import SceneSetup
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.scene.fusion_scheduler import FusionRequest, FusionScheduler


class SceneLink:
    """Keeps the process, if dense map or object tracks are on."""

    def __init__(self, node: Node, config: SlamNodeConfig, diagnostics: Diagnostics) -> None:
        self._config = config
        self._diagnostics = diagnostics
        self._process: SceneProcess | None = None
        self._camera: CameraModel | None = None
        if config.dense.enabled or config.objects.enabled:
            self._process = SceneProcess(
                SceneSetup(
                    node.get_fully_qualified_name(), config.frames.map, config.map_directory,
                    config.dense, config.objects, config.input,
                )
            )  # fmt: skip

    def fusion_scheduler(self) -> FusionScheduler:
        """Return what picks the images to look at."""
        dense, objects = self._config.dense, self._config.objects
        return FusionScheduler(
            dense.rate_hz if dense.enabled else None, objects.rate_hz if objects.enabled else None
        )

    def reconfigure(self, config: SlamNodeConfig) -> None:
        """Take over parameters that may change at run time."""
        self._config = config
        if self._process is not None:
            self._process.reconfigure(config.dense)

    def start_map(self, camera: CameraModel) -> None:
        """Begin an empty map."""
        self._camera = camera
        if self._process is not None:
            self._process.start_map(camera)

    def clear(self) -> None:
        """Forget the map."""
        if self._process is not None:
            self._process.clear()

    def views(self, keyframes: KeyframePoses) -> Callable[[], list[StoredView]] | None:
        """Ask for the images of the dense map as they hang on keyframes; the act waits for them.

        None without a dense map.
        """
        process = self._process
        if process is None or not self._config.dense.enabled or not process.is_running:
            return None
        process.update_keyframes(keyframes)
        process.ask_views()
        return process.receive_views

    def load(self, dense: DenseState | None, loaded: LoadedMap, *, keep: bool) -> str:
        """Lay a saved dense map over the running one, and say what cannot be done of it."""
        process, camera = self._process, self._camera
        if process is None or camera is None or not self._config.dense.enabled:
            return '' if dense is None else '; the dense map is off here'
        if not keep:
            process.start_map(camera)
        process.update_keyframes(loaded.keyframes)
        if dense is None:
            return ''
        if not dense.fits(camera, self._config.dense.pixel_stride):
            return '; its dense map is left out: it was made with another dense.pixel_stride'
        for view in dense.views(loaded.keyframe_uids):
            process.restore(view)
        return ''

    def enqueue(self, pose: FusionRequest | None) -> None:
        """Say where an image was taken that is to be looked at."""
        if self._process is None or pose is None:
            return
        self._process.enqueue(pose)
        self._diagnostics.set_count('images not mapped', self._process.num_dropped)
        if not self._process.is_running:
            self._diagnostics.set_problem(
                'room', 'the process of dense map and objects has ended; restart the node'
            )

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
