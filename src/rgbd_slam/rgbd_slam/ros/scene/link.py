"""The room's maps as the SLAM node sees them: made beside it when wanted, published by it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rclpy.node import Node
from rclpy.publisher import Publisher

from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.values import CameraModel
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.robot_map import LoadedMap
from rgbd_slam.ros.scene.messages import Output, SceneSetup
from rgbd_slam.ros.scene.outputs import TOPICS
from rgbd_slam.ros.scene.process import SceneProcess
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.scene.fusion_scheduler import FusionRequest, FusionScheduler

_PROBLEM = 'room'
_ENDS = 'room processes that died'


class SceneLink:
    """Keeps the process, if dense map or object tracks are on, and publishes what it makes."""

    def __init__(self, node: Node, config: SlamNodeConfig, diagnostics: Diagnostics) -> None:
        self._config = config
        self._node = node
        self._diagnostics = diagnostics
        self._process: SceneProcess | None = None
        self._camera: CameraModel | None = None
        self._publishers: dict[str, Publisher] = {}
        if not config.dense.enabled and not config.objects.enabled:
            return
        self._publishers = {
            topic: node.create_publisher(type_, topic, profile)
            for topic, (type_, profile) in TOPICS.items()
            if topic != topics.TF_STATIC or not config.frames.base
        }
        diagnostics.set_count(_ENDS, 0)
        setup = SceneSetup(
            f'{node.get_name()}_scene', config.frames.map, bool(config.frames.base),
            config.dense, config.objects, config.input,
        )  # fmt: skip
        self._process = SceneProcess(setup, self)

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

        Their colour has half the resolution of depth. None without a dense map.
        """
        process = self._process
        if process is None or not self._config.dense.enabled:
            return None
        process.update_keyframes(keyframes)
        number = process.order()

        def receive() -> list[StoredView]:
            process.await_answer(number)
            return process.small_views()

        return receive

    def small_views(self) -> list[StoredView]:
        """Return the images of the dense map, their colour at half the resolution of depth.

        They are as the process reported them last: nothing waits.
        """
        is_on = self._process is not None and self._config.dense.enabled
        return self._process.small_views() if self._process is not None and is_on else []

    def save(self, *, cloud_path: Path | None = None, grid_path: Path | None = None) -> str:
        """Have dense map or grid written, wait for it, and say what was.

        Raises:
            InputError: There is none, it cannot be written, or the process has ended.
        """
        if self._process is None or not self._config.dense.enabled:
            raise InputError('the dense map is off here: dense.enabled is false')
        number = self._process.order(cloud_path=cloud_path, grid_path=grid_path)
        return self._process.await_answer(number)

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

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()

    def published(self, output: Output) -> None:
        """Publish what the process has made, in the thread that hears of it."""
        self._diagnostics.clear_problem(_PROBLEM)  # it is there again
        self._publishers[output.topic].publish(output.data)

    def ended(self, how: str, *, is_restarted: bool) -> None:
        """Say that the process has ended, in the same thread."""
        self._diagnostics.count(_ENDS)
        said = f'the process of dense map and objects has ended ({how})'
        if is_restarted:
            text = f'{said}; a new one makes the dense map again'
        else:
            text = f'{said} at its start again and again; see its output and restart the node'
        self._diagnostics.set_problem(_PROBLEM, text, severe=not is_restarted)
