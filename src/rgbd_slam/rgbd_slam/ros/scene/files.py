"""Dense map and grid as files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hoid_common.errors import InputError
from rgbd_slam.map_io.map_directory import write_whole
from rgbd_slam.scene.export import CLOUD_WRITERS
from rgbd_slam.scene.grid import Grid, write_map_server
from rgbd_slam.scene.scene_mapper import SceneMapper
from rgbd_slam.scene.voxel_map import ColoredCloud


def save_cloud(room: SceneMapper | None, path: Path) -> str:
    """Write the dense map by the path's ending and say so.

    Raises:
        InputError: There is none, or it cannot be written.
    """
    cloud = _mapped(room).cloud()
    write_whole(path, lambda aside: CLOUD_WRITERS[path.suffix](aside, cloud))
    return f'{len(cloud.points_m)} points written to {path}'


def save_grid(
    room: SceneMapper | None,
    grid_of: Callable[[SceneMapper, ColoredCloud], Grid | None],
    path: Path,
    mode: str,
) -> str:
    """Write the grid as Nav2's map server reads it and say so.

    Args:
        room: Gives the dense map; None for none.
        grid_of: Gives its grid, or None without a floor.
        path: Of either file that is written.
        mode: Of Nav2's map server.

    Raises:
        InputError: There is none, or it cannot be written.
    """
    room = _mapped(room)
    grid = grid_of(room, room.cloud())
    if grid is None:
        raise InputError('no floor has been seen yet: a grid needs one')
    stem = path.with_suffix('')
    write_whole(stem, lambda aside: write_map_server(grid, aside, mode))
    height, width = grid.cells.shape
    return f'{width}x{height} cells written to {stem}.yaml and its picture'


def _mapped(room: SceneMapper | None) -> SceneMapper:
    if room is None or room.num_voxels == 0:
        raise InputError('no image has been fused yet: there is no dense map to save')
    return room
