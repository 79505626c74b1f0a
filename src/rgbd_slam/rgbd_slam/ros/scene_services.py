"""Services that save the dense map and the grid."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hoid_msgs.srv import SaveMap
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.io.files import scratch_folder, unwritable
from rgbd_slam.map_io.map_directory import path_in
from rgbd_slam.ros.answers import answered
from rgbd_slam.ros.scene_setup import SceneSetup
from rgbd_slam.scene.export import CLOUD_WRITERS
from rgbd_slam.scene.grid import write_map_server
from rgbd_slam.scene.scene_mapper import SceneMapper

_GRID_SUFFIXES = ('.yaml', '.pgm')


class SceneServices:
    """Answers under the name of the SLAM node, as its other services do.

    Args:
        room: Gives the map, or None while there is none.
    """

    def __init__(
        self, node: Node, setup: SceneSetup, room: Callable[[], SceneMapper | None]
    ) -> None:
        self._directory = setup.map_directory
        self._find_room = room
        for topic, act in (
            (topics.SAVE_CLOUD, self._save_cloud),
            (topics.SAVE_GRID, self._save_grid),
        ):
            node.create_service(SaveMap, topic.replace('~', setup.slam_node), _answering(act))

    def _scene(self) -> SceneMapper:
        room = self._find_room()
        if room is None or room.num_voxels == 0:
            raise InputError('no image has been fused yet: there is no dense map to save')
        return room

    def _save_cloud(self, name: str) -> str:
        path = path_in(self._directory, name, 'cloud.ply')
        writer = CLOUD_WRITERS.get(path.suffix)
        if writer is None:
            raise InputError(f'"{path.name}": a cloud ends in {" or ".join(CLOUD_WRITERS)}')
        cloud = self._scene().cloud()
        _write_whole(path.parent, lambda folder: writer(folder / path.name, cloud))
        return f'{len(cloud.points_m)} points written to {path}'

    def _save_grid(self, name: str) -> str:
        path = path_in(self._directory, name, 'grid.yaml')
        stem = path.stem if path.suffix in _GRID_SUFFIXES else path.name
        room = self._scene()
        grid = room.grid(room.cloud())
        if grid is None:
            raise InputError('no floor has been seen yet: a grid needs one')
        _write_whole(path.parent, lambda folder: write_map_server(grid, folder / stem))
        height, width = grid.cells.shape
        return f'{width}x{height} cells written to {path.parent / stem}.yaml and .pgm'


def _answering(act: Callable[[str], str]) -> Callable[..., SaveMap.Response]:
    def answer(request: SaveMap.Request, response: SaveMap.Response) -> SaveMap.Response:
        return answered(response, lambda: act(request.name))

    return answer


def _write_whole(folder: Path, write: Callable[[Path], None]) -> None:
    """Write files aside, and move them into the folder when all are there."""
    try:
        with scratch_folder(folder, 'partial') as aside:
            write(aside)
            for file in sorted(aside.iterdir()):
                file.replace(folder / file.name)
    except OSError as error:
        raise unwritable(folder, error) from error
