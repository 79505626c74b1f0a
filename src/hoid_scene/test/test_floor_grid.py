"""Floor and grid of the points of a known room."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from hoid_common import se3
from hoid_common.errors import ConfigError, InputError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel, FloatArray
from hoid_scene.config.dense_config import DenseConfig, GridConfig
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.floor import find_floor
from hoid_scene.grid.grid import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Grid,
    SubmapCells,
    cells_of,
    compose_grid,
    write_map_server,
)
from hoid_scene.grid.steady_grid import SteadyGrid
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest

ALL_FREE = 0xFFFF
NO_CELLS = SubmapCells(np.empty((0, 2), np.int64), np.empty(0, np.uint8), np.empty(0, np.uint16))


def project_grid(
    points_m: FloatArray,
    T_map_level: FloatArray,
    config: GridConfig,
    unconfirmed_m: FloatArray = np.empty((0, 3)),  # noqa: B008 - is never changed
    free_above: int = ALL_FREE,
) -> Grid:
    """Return the grid of points in the map frame, which it divides among three submaps."""
    points = np.concatenate([points_m, unconfirmed_m])
    points = se3.transform(np.asarray(np.linalg.inv(T_map_level), np.float64), points)
    is_shown = np.arange(len(points)) < len(points_m)
    free = np.full(len(points), free_above, np.uint16)
    parts: list[SubmapCells] = [
        cells_of(points[i::3], is_shown[i::3], free[i::3], config) for i in range(3)
    ]
    return compose_grid(parts, T_map_level, config)


def room(rng: np.random.Generator) -> FloatArray:
    floor = np.c_[rng.uniform(0, 4, (4000, 2)), rng.normal(0, 0.005, 4000)]
    table = np.c_[rng.uniform(1, 2, (3000, 2)), rng.normal(0.7, 0.005, 3000)]
    walls = np.c_[rng.uniform(0, 4, 2000), np.full(2000, 4.0), rng.uniform(0, 2.4, 2000)]
    return np.concatenate([floor, table, walls])


@pytest.mark.parametrize('tilt_deg', [35, 45, 60])
def test_the_lowest_edge_of_a_tilted_map_is_no_floor(tilt_deg: float) -> None:
    T = se3.exp(np.array([np.deg2rad(tilt_deg), 0, 0, 0, 0, 0]))
    rng = np.random.default_rng(1)
    corner = np.concatenate(
        [np.c_[rng.uniform(0, 4, (8000, 2)), rng.normal(0, 0.005, 8000)],
         np.c_[rng.uniform(0, 4, 6000), rng.normal(0, 0.005, 6000), rng.uniform(0, 2.4, 6000)]]
    )  # fmt: skip
    assert find_floor(se3.transform(T, corner), np.array([0, 0, 1.0])) is None


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


def test_the_grid_has_free_occupied_and_unknown_cells() -> None:
    points = room(np.random.default_rng(3))
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=0.1))
    assert grid.T_map_origin[:2, 3] == pytest.approx([0, 0])
    assert grid.cells[30, 30] == FREE
    assert grid.cells[15, 15] == OCCUPIED
    assert grid.cells.shape == (41, 40)
    assert set(np.unique(grid.cells)) <= {FREE, OCCUPIED, UNKNOWN}


def test_obstacles_are_between_two_heights() -> None:
    points = np.array([[0.5, 0.5, 0.05]] * 3 + [[1.5, 0.5, 0.5]] * 3 + [[2.5, 0.5, 2.2]] * 3)
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=1.0))
    assert grid.cells.tolist() == [[FREE, OCCUPIED]]


def test_the_floor_below_an_unconfirmed_point_is_not_free() -> None:
    points = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.0]])
    unconfirmed = np.array([[1.5, 0.5, 0.7], [0.5, 0.5, 2.5], [9.0, 9.0, 0.5]])
    config = GridConfig(resolution_m=1.0)
    assert project_grid(points, np.eye(4), config, unconfirmed).cells.tolist() == [[FREE, UNKNOWN]]


def test_the_floor_is_not_free_until_the_space_above_it_is() -> None:
    points = np.array([[0.5, 0.5, 0.0]])
    config = GridConfig(resolution_m=1.0)
    from_10_to_70_cm = sum(1 << k for k in range(2, 14))
    from_10_to_80_cm = sum(1 << k for k in range(2, 16))
    for bits, cell in ((0, UNKNOWN), (from_10_to_70_cm, UNKNOWN), (from_10_to_80_cm, FREE)):
        grid = project_grid(points, np.eye(4), config, free_above=bits)
        assert grid.cells.tolist() == [[cell]]


def test_images_of_two_submaps_together_show_a_cell_to_be_free() -> None:
    points, config = np.array([[0.5, 0.5, 0.0]]), GridConfig(resolution_m=1.0)
    shown = np.ones(1, bool)
    low, high = (np.array([bits], np.uint16) for bits in (0x00FF, 0xFF00))
    parts = [cells_of(points, shown, bits, config) for bits in (low, high)]
    assert compose_grid(parts, np.eye(4), config).cells.tolist() == [[FREE]]
    assert compose_grid(parts[:1], np.eye(4), config).cells.tolist() == [[UNKNOWN]]


def nav2_cells(yaml_path: Path) -> tuple[list[list[int]], FloatArray]:
    """Read a map as Nav2's map server does (nav2_map_server/src/map_io.cpp)."""
    document = yaml.safe_load(yaml_path.read_text())
    image = cv2.imread(str(yaml_path.parent / document['image']), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert (document['mode'], document['negate']) == ('trinary', 0)
    taken = 1 - image / 255
    occupied, free = document['occupied_thresh'], document['free_thresh']
    cells = np.where(taken > occupied, 100, np.where(taken < free, 0, -1))
    return cells[::-1].astype(int).tolist(), np.array(document['origin'])


def test_nav2_reads_a_saved_grid_as_it_is(tmp_path: Path) -> None:
    points = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.5], [1.5, 0.5, 0.6], [-1.5, 2.5, 0.0]])
    grid = project_grid(points, np.eye(4), GridConfig(resolution_m=1.0))
    assert {FREE, OCCUPIED, UNKNOWN} == set(np.unique(grid.cells))
    write_map_server(grid, tmp_path / '2024.05.17')
    cells, origin = nav2_cells(tmp_path / '2024.05.17.yaml')
    assert cells == grid.cells.tolist()
    assert origin.tolist() == [-2.0, 0.0, 0.0]
    assert len(list(tmp_path.iterdir())) == 2


def test_a_grid_whose_image_cannot_be_written_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / 'map.pgm').mkdir()
    grid = Grid(np.full((2, 2), FREE, np.int8), 0.05, np.eye(4), (0, 0))
    with pytest.raises(IsADirectoryError):
        write_map_server(grid, tmp_path / 'map')
    assert not (tmp_path / 'map.yaml').exists()


def test_a_grid_without_cells_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    empty = compose_grid([NO_CELLS], np.eye(4), GridConfig())
    assert empty.cells.shape == (0, 0)
    with pytest.raises(InputError, match='no cell of the grid is confirmed yet'):
        write_map_server(empty, tmp_path / 'map')
    assert list(tmp_path.iterdir()) == []


def test_a_tilted_floor_gives_a_level_grid() -> None:
    """The frame of the grid is level: one of its own, or one with the map's x and y."""
    points = room(np.random.default_rng(3))
    T_map_room = se3.exp(np.array([0.01, -0.02, 0.0, 0.2, -0.3, -1.2]))
    points_m = se3.transform(T_map_room, points)
    floor = find_floor(points_m, np.array([0, 0, 1.0]))
    assert floor is not None
    config = GridConfig(resolution_m=0.2)
    for T_map_level in (floor.T_map_floor, floor.T_map_ground):
        grid = project_grid(points_m, T_map_level, config)
        T_level_map = np.asarray(np.linalg.inv(T_map_level), np.float64)
        heights_m = se3.transform(T_level_map, points_m[:4000])[:, 2]
        np.testing.assert_allclose(heights_m, 0, atol=0.03)
        x_m, y_m = np.array(grid.origin_m) + 0.2 * 0.5
        for place, state in (((3.0, 3.0), FREE), ((1.5, 1.5), OCCUPIED)):
            at = se3.transform(T_level_map @ T_map_room, np.array([[*place, 0.0]]))
            column, row = np.rint((at[0, :2] - (x_m, y_m)) / 0.2).astype(int)
            assert grid.cells[row, column] == state
    xy_m = se3.transform(floor.T_map_ground, np.array([[1.0, 2.0, 0.5]]))[0, :2]
    assert xy_m.tolist() == [1.0, 2.0]


def test_the_grid_follows_when_the_plane_of_the_floor_changes() -> None:
    """The submap has a wall and no floor, so that only the plane determines its heights."""
    camera = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
    scene = SceneMapper(camera, DenseConfig(), ObjectTrackerConfig())
    known = KeyframePoses(1, np.zeros(1, np.int64), np.zeros(1, np.int64), 0, T_BODY_OPTICAL[None])
    for _ in range(3):
        request = SceneRequest(0, T_BODY_OPTICAL, 0, known)
        scene.fuse(
            request, np.full((120, 160), 1.3, np.float32), np.zeros((120, 160, 3), 'u1'), ()
        )
    occupied = []
    for ground_m in (-0.7, -2.5):  # below the wall's lower edge, and 2 m below its upper one
        xy_m = np.random.default_rng(1).uniform(0, 4, (20_000, 2))
        points = np.c_[xy_m, np.full(20_000, ground_m)].astype(np.float32)
        grid = scene.grid(ColoredCloud(points, np.zeros((20_000, 3), np.uint8)))
        assert grid is not None
        occupied.append(np.count_nonzero(grid.cells == OCCUPIED))
    assert occupied[0] > 10
    assert occupied[1] == 0


def test_a_steady_grid_grows_in_steps_and_returns_the_changed_cells() -> None:
    steady = SteadyGrid()
    cells = np.full((10, 15), FREE, np.int8)
    first = steady.place(Grid(cells, 0.1, np.eye(4), (-3, 5)))
    assert (first.low, first.cells.shape) == ((-20, 0), (20, 40))
    assert (first.cells[5:15, 17:32] == FREE).all()
    assert np.count_nonzero(first.cells == UNKNOWN) == first.cells.size - cells.size
    assert steady.take_patch(first) is None
    cells = cells.copy()
    cells[2:4, 6] = OCCUPIED
    second = steady.place(Grid(cells, 0.1, np.eye(4), (-3, 5)))
    assert (second.low, second.cells.shape) == (first.low, first.cells.shape)
    patch = steady.take_patch(second)
    assert patch is not None
    assert (patch.column, patch.row, patch.cells.tolist()) == (23, 7, [[OCCUPIED], [OCCUPIED]])
    smaller = steady.place(Grid(cells[:2, :2], 0.1, np.eye(4), (0, 5)))
    assert (smaller.low, smaller.cells.shape) == (first.low, first.cells.shape)
    larger = steady.place(Grid(cells, 0.1, np.eye(4), (18, 5)))
    assert (larger.low, larger.cells.shape) == ((-20, 0), (20, 60))
    assert steady.take_patch(larger) is None
    steady.clear()
    assert steady.place(Grid(cells, 0.1, np.eye(4), (18, 5))).low == (0, 0)


def test_a_grid_without_any_height_for_obstacles_is_refused() -> None:
    with pytest.raises(ConfigError, match='min_height_m'):
        GridConfig(min_height_m=1.0, max_height_m=0.5)
