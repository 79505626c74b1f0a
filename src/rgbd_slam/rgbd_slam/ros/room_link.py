"""The room mapper beside the SLAM node: started with it when wanted, and missed when it ends."""

from __future__ import annotations

from rclpy.node import Node

from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.values import CameraModel
from rgbd_slam.frame_poses import FramePose, FramePoses
from rgbd_slam.node_config import SlamNodeConfig
from rgbd_slam.ros.room_process import RoomProcess
from rgbd_slam.ros.room_setup import RoomSetup


class RoomLink:
    """Keeps the process, if dense map or object tracks are on."""

    def __init__(self, node: Node, config: SlamNodeConfig, diagnostics: Diagnostics) -> None:
        self._config = config
        self._diagnostics = diagnostics
        self._process: RoomProcess | None = None
        if config.dense.enabled or config.objects.enabled:
            self._process = RoomProcess(
                RoomSetup(
                    node.get_fully_qualified_name(), config.frames.map, config.map_directory,
                    config.dense, config.objects, config.input,
                )
            )  # fmt: skip

    def looks(self) -> FramePoses:
        """Return what picks the images to look at."""
        dense, objects = self._config.dense, self._config.objects
        return FramePoses(
            dense.rate_hz if dense.enabled else None, objects.rate_hz if objects.enabled else None
        )

    def start_map(self, camera: CameraModel) -> None:
        """Begin an empty map."""
        if self._process is not None:
            self._process.start_map(camera)

    def clear(self) -> None:
        """Forget the map."""
        if self._process is not None:
            self._process.clear()

    def look(self, pose: FramePose | None) -> None:
        """Say where an image was taken that is to be looked at."""
        if self._process is None or pose is None:
            return
        self._process.look(pose)
        self._diagnostics.set_count('images not mapped', self._process.num_dropped)
        if not self._process.is_running:
            self._diagnostics.set_problem(
                'room', 'the process of dense map and objects has ended; restart the node'
            )

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
