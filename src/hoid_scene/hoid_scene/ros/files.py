"""Writes the dense map, the grid and the list of objects to files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hoid_common.errors import InputError
from hoid_common.store.map_directory import write_whole
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.export import write_ply
from hoid_scene.grid.floor import NO_FLOOR
from hoid_scene.grid.grid import Grid, write_map_server
from hoid_scene.objects.object_list import objects_yaml
from hoid_scene.scene_mapper import SceneMapper


def save_cloud(scene: SceneMapper | None, path: Path) -> str:
    """Write the dense map as a PLY file; return a message for the user."""
    cloud = _require_map(scene).cloud()
    write_whole(path, lambda aside: write_ply(aside, cloud))
    return f'{len(cloud.points_m)} points written to {path}'


def save_grid(
    scene: SceneMapper | None,
    grid_of: Callable[[SceneMapper, ColoredCloud], Grid | None],
    path: Path,
) -> str:
    """Write the grid in the format of Nav2's map server; return a message for the user.

    Args:
        grid_of: Returns the grid of a cloud of the scene, or None if no floor is known.

    Raises:
        InputError: There is no dense map, no floor or no cell is known, or a file cannot be
            written.
    """
    scene = _require_map(scene)
    grid = grid_of(scene, scene.cloud())
    if grid is None:
        raise InputError(NO_FLOOR)
    stem = path.with_suffix('')
    write_whole(stem, lambda aside: write_map_server(grid, aside))
    height, width = grid.cells.shape
    return f'{width}x{height} cells written to {stem}.yaml and its picture'


def save_objects(scene: SceneMapper | None, path: Path, frame: str) -> str:
    """Write the list of mapped objects as a YAML file; return a message for the user."""
    objects = () if scene is None else scene.mapped_objects()
    text = objects_yaml(objects, frame)
    write_whole(path, lambda aside: aside.write_text(text, encoding='utf-8'))
    return f'{len(objects)} objects written to {path}'


def _require_map(scene: SceneMapper | None) -> SceneMapper:
    if scene is None or len(scene.dense) == 0:
        raise InputError('no image has been fused yet: there is no dense map to save')
    return scene
