"""Free space above the floor, and the height of the floor in each part of a map."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel, Float32Array, FloatArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.grid.grid import FREE, OCCUPIED, UNKNOWN, Grid
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
HEIGHT_M = 1.0  # of the camera, which looks along x and down by 20 degrees
PITCH = se3.exp(np.array([0, np.deg2rad(20), 0, 0, 0, 0]))
BGR = np.zeros((120, 160, 3), np.uint8)


def camera_pose(x_m: float, z_m: float = HEIGHT_M) -> FloatArray:
    T = PITCH @ T_BODY_OPTICAL
    T[:3, 3] = x_m, 0, z_m
    return T


def depth_of_floor(hidden_above_row: int = 0) -> Float32Array:
    """Return the depth of a level floor that ends before a wall out of the range of the map.

    The rows of the image above a given one have no reading.
    """
    v, u = np.mgrid[0:120, 0:160]
    rays = np.stack([(u - 79.5) / 130, (v - 59.5) / 130, np.ones_like(u, float)], axis=2)
    down = -(rays @ camera_pose(0.0)[:3, :3].T)[..., 2]
    depth_m = np.minimum(HEIGHT_M / np.maximum(down, 0.01), 3.6)
    depth_m[:hidden_above_row] = 0
    return depth_m.astype(np.float32)


def mapper() -> SceneMapper:
    return SceneMapper(
        CAMERA, DenseConfig(pixel_stride=1), ObjectTrackerConfig(), is_map_level=True
    )


def fuse(scene: SceneMapper, depth_m: Float32Array, poses: list[FloatArray]) -> Grid:
    uids = np.arange(len(poses))
    known = KeyframePoses(1, uids, np.zeros(len(poses), np.int64), 0, np.array(poses))
    for uid, T in enumerate(poses):
        for _ in range(3):
            scene.fuse(SceneRequest(0, T, uid, known), depth_m, BGR, ())
    grid = scene.grid(scene.cloud())
    assert grid is not None
    return grid


def cell(grid: Grid, x_m: float, y_m: float) -> int:
    column, row = np.floor(np.array([x_m, y_m]) / grid.resolution_m).astype(int) - grid.low
    return int(grid.cells[row, column])


def test_the_floor_is_free_where_the_space_above_it_was_seen() -> None:
    grid = fuse(mapper(), depth_of_floor(), [camera_pose(0.0)])
    assert cell(grid, 2.0, 0.02) == FREE
    hidden = fuse(mapper(), depth_of_floor(hidden_above_row=60), [camera_pose(0.0)])
    assert cell(hidden, 1.6, 0.02) == UNKNOWN


def test_space_seen_before_the_last_grid_stays_free() -> None:
    scene = mapper()
    fuse(scene, depth_of_floor(), [camera_pose(0.0)])
    for _ in range(3):
        grid = fuse(scene, depth_of_floor(hidden_above_row=60), [camera_pose(0.0)])
    assert cell(grid, 2.0, 0.02) == FREE


def test_a_floor_that_rises_slowly_is_free_everywhere() -> None:
    """Drift of a long corridor: 3 cm per 2 m, in all 36 cm, far above the height of obstacles."""
    poses = [camera_pose(2.0 * k, HEIGHT_M + 0.03 * k) for k in range(13)]
    grid = fuse(mapper(), depth_of_floor(), poses)
    assert not (grid.cells == OCCUPIED).any()
    assert [cell(grid, x_m, 0.02) for x_m in (2.0, 8.0, 14.0, 20.0, 26.0)] == [FREE] * 5


@pytest.mark.parametrize('turn_rad', [0.0, 0.3])
def test_the_grid_moves_with_the_map(turn_rad: float) -> None:
    scene = mapper()
    fuse(scene, depth_of_floor(), [camera_pose(0.0)])
    T = se3.exp(np.array([0, 0, turn_rad, 1.0, 2.0, 0.0]))
    one = np.zeros(1, np.int64)
    scene.dense.correct(KeyframePoses(2, one, one, 0, (T @ camera_pose(0.0))[None]))
    grid = scene.grid(scene.cloud())
    assert grid is not None
    x_m, y_m, _ = (T @ np.array([2.0, 0.02, 0.0, 1.0]))[:3]
    assert cell(grid, x_m, y_m) == FREE
