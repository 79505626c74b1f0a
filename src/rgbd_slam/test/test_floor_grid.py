"""Floor and grid of points whose room is known."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.values import FloatArray
from rgbd_slam.config.dense_config import GridConfig
from rgbd_slam.scene.floor import find_floor
from rgbd_slam.scene.grid import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    project_grid,
    without_unseen,
    write_map_server,
)


def room(rng: np.random.Generator) -> FloatArray:
    floor = np.c_[rng.uniform(0, 4, (4000, 2)), rng.normal(0, 0.005, 4000)]
    table = np.c_[rng.uniform(1, 2, (3000, 2)), rng.normal(0.7, 0.005, 3000)]
    walls = np.c_[rng.uniform(0, 4, 2000), np.full(2000, 4.0), rng.uniform(0, 2.4, 2000)]
    return np.concatenate([floor, table, walls])


def test_the_floor_is_found_below_a_larger_table_and_through_tilt() -> None:
    points = room(np.random.default_rng(1))
    T_map_room = se3.exp(np.array([0.08, -0.05, 0.4, 0.2, -0.3, -1.2]))
    floor = find_floor(se3.transform(T_map_room, points), np.array([0, 0, 1.0]))
    assert floor is not None
    heights = se3.transform(se3.inverse(floor.T_map_floor) @ T_map_room, points[:4000])[:, 2]
    np.testing.assert_allclose(heights, 0, atol=0.03)


def test_a_table_alone_over_unseen_ground_is_no_floor_when_points_lie_below() -> None:
    points = room(np.random.default_rng(2))[4000:]
    points[-400:, 2] -= 1.5
    assert find_floor(points, np.array([0, 0, 1.0])) is None


def test_the_grid_knows_floor_obstacles_and_the_unseen() -> None:
    points = room(np.random.default_rng(3))
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=0.1, obstacle_margin_m=0.0))
    assert grid.T_map_origin[:2, 3] == pytest.approx([0, 0])
    assert grid.cells[30, 30] == FREE
    assert grid.cells[15, 15] == OCCUPIED
    assert grid.cells.shape == (41, 40)
    assert set(np.unique(grid.cells)) <= {FREE, OCCUPIED, UNKNOWN}


def test_heights_limit_what_is_an_obstacle() -> None:
    points = np.array([[0.5, 0.5, 0.05]] * 3 + [[1.5, 0.5, 0.5]] * 3 + [[2.5, 0.5, 2.2]] * 3)
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=1.0))
    assert grid.cells.tolist() == [[FREE, OCCUPIED]]


def test_obstacles_reach_a_little_farther_than_their_points() -> None:
    points = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.0], [1.005, 0.5, 0.5]])
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=1.0, obstacle_margin_m=0.01))
    assert grid.cells.tolist() == [[OCCUPIED, OCCUPIED]]
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=1.0, obstacle_margin_m=0.0))
    assert grid.cells.tolist() == [[FREE, OCCUPIED]]


def test_floor_below_something_doubtful_is_not_free() -> None:
    points = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.0]])
    doubtful = np.array([[1.5, 0.5, 0.7], [0.5, 0.5, 2.5], [9.0, 9.0, 0.5]])
    config = GridConfig(resolution_m=1.0)
    assert project_grid(points, np.eye(4), config, doubtful).cells.tolist() == [[FREE, UNKNOWN]]


def test_floor_is_not_free_before_the_space_over_it_was_seen() -> None:
    points = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.0]])
    config = GridConfig(resolution_m=1.0, clear_height_m=0.8)
    grid = project_grid(points, np.eye(4), config)
    low = without_unseen(grid, config, lambda p: (p[:, 0] < 1) | (p[:, 2] < 0.7))
    assert low.cells.tolist() == [[FREE, UNKNOWN]]
    assert without_unseen(grid, config, lambda p: p[:, 2] < 0.8).cells.tolist() == [[FREE, FREE]]


def test_map_server_files_read_back(tmp_path: Path) -> None:
    points = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.5], [1.5, 0.5, 0.6], [0.5, 2.5, 0.0]])
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=1.0))
    write_map_server(grid, tmp_path / 'room')
    image = cv2.imread(str(tmp_path / 'room.pgm'), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.tolist() == [[254, 205], [205, 205], [254, 0]]
    text = (tmp_path / 'room.yaml').read_text()
    assert 'image: room.pgm' in text
    assert 'origin: [0.000000, 0.000000, 0.000000]' in text


def test_a_grid_without_any_height_for_obstacles_is_refused() -> None:
    with pytest.raises(ConfigError, match='min_height_m'):
        GridConfig(min_height_m=1.0, max_height_m=0.5)
