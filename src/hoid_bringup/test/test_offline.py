"""The offline pipeline on a textured wall along which the camera slides, with known poses."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_bringup.run.offline import MapFiles, run_offline
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common.errors import InputError
from hoid_common.values import CameraModel, Detections, RgbdFrame, Trajectory
from rgbd_slam.store import map_file

CAMERA = CameraModel(320, 240, 260.0, 260.0, 159.5, 119.5)
WALL_M = 2.0
STEP_M = 2 * WALL_M / CAMERA.fx_px  # two pixels a frame
FRAMES = 24
PERIOD_NS = 33_333_333
STRAY_M = np.array([1e5, 1e-4, 1e30, 101.0], np.float32)


@dataclass
class WallSequence:
    """A recording in which the camera slides right, then down, along a wall 2 m away."""

    name: str = 'wall'
    camera: CameraModel = CAMERA
    true_detections: dict[int, Detections] | None = None
    fault: str | None = None

    def __post_init__(self) -> None:
        noise = np.random.default_rng(5).integers(0, 255, (90, 110, 3), np.uint8)
        wall = cv2.resize(noise, (550, 450), interpolation=cv2.INTER_CUBIC)
        self.wall = np.asarray(wall, np.uint8)

    def __len__(self) -> int:
        return FRAMES

    def step(self, i: int) -> tuple[int, int]:
        return min(i, FRAMES // 2), max(0, i - FRAMES // 2)

    def __iter__(self) -> Iterator[RgbdFrame]:
        depth_m = np.full((240, 320), WALL_M, np.float32)
        for i in range(FRAMES):
            x, y = (2 * s for s in self.step(i))
            view = np.ascontiguousarray(self.wall[20 + y : 260 + y, 20 + x : 340 + x])
            yield RgbdFrame(i * PERIOD_NS, view, depth_m)

    @property
    def ground_truth(self) -> Trajectory:
        T = np.tile(np.eye(4), (FRAMES, 1, 1))
        for i in range(FRAMES):
            T[i, :2, 3] = np.array(self.step(i)) * STEP_M
        return Trajectory(PERIOD_NS * np.arange(FRAMES), T)


class StrayWall(WallSequence):
    """The same wall, seen by a camera whose depth images contain values that are no depths."""

    def __iter__(self) -> Iterator[RgbdFrame]:
        rng = np.random.default_rng(1)
        for frame in super().__iter__():
            depth_m = frame.depth_m.copy()
            is_stray = rng.random(depth_m.shape) < 0.05
            depth_m[is_stray] = rng.choice(STRAY_M, is_stray.sum())
            yield replace(frame, depth_m=depth_m)


@pytest.fixture(scope='module', autouse=True)
def _no_pictures() -> Iterator[None]:
    """Skip the plot of each run, which takes longer than the run and is tested in test_outputs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('hoid_bringup.run.outputs.plot_run', lambda *_: None)
        yield


@pytest.fixture(scope='module')
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the folders of two equal runs."""
    config = RunConfig().updated({'filter.strategy': 'none'})
    first, second = (tmp_path_factory.mktemp(name) for name in 'ab')
    for out in (first, second):
        run_offline(WallSequence(), config, out, dense=True, show_progress=False)
    return first, second


def test_a_known_trajectory_is_recovered(runs: tuple[Path, Path]) -> None:
    summary = json.loads((runs[0] / 'summary.json').read_text())
    assert summary['coverage'] == 1.0
    assert summary['frames_processed'] == FRAMES
    assert summary['ate_rmse_m'] < 0.005
    assert summary['map_points'] > 100
    timed = {name for name, spread in summary['stage_ms'].items() if spread is not None}
    assert timed == {'extract', 'filter', 'track', 'map', 'frame'}
    # The strategy needs no detections, so no detector was loaded.
    assert summary['stage_ms']['detect'] is None


def test_equal_runs_give_equal_bytes(runs: tuple[Path, Path]) -> None:
    for name in (
        'trajectory.txt',
        'trajectory_online.txt',
        'keyframes.txt',
        'map.ply',
        'cloud.ply',
    ):
        assert (runs[0] / name).read_bytes() == (runs[1] / name).read_bytes()


def test_the_map_is_z_up_with_the_camera_looking_along_x(runs: tuple[Path, Path]) -> None:
    ply = (runs[0] / 'map.ply').read_bytes()
    points_m = np.frombuffer(ply[ply.index(b'end_header\n') + 11 :], '<f4').reshape(-1, 3)
    assert np.median(points_m[:, 0]) == pytest.approx(WALL_M, abs=0.02)
    last = (runs[0] / 'trajectory.txt').read_text().splitlines()[-1].split()
    right, down = (s * STEP_M for s in WallSequence().step(FRAMES - 1))
    assert [float(v) for v in last[1:4]] == pytest.approx([0, -right, -down], abs=0.01)


def test_the_dense_map_shows_the_wall_and_no_grid_without_a_floor(runs: tuple[Path, Path]) -> None:
    ply = (runs[0] / 'cloud.ply').read_bytes()
    layout = np.dtype([('xyz', '<f4', 3), ('rgb', 'u1', 3)])
    points = np.frombuffer(ply[ply.index(b'end_header\n') + 11 :], layout)
    assert len(points) > 2000
    np.testing.assert_allclose(points['xyz'][:, 0], WALL_M, atol=0.02)
    assert np.ptp(points['rgb']) > 100
    assert not (runs[0] / 'grid.pgm').exists()


def test_a_dense_map_is_made_on_request_only(tmp_path: Path) -> None:
    config = RunConfig().updated({'filter.strategy': 'none'})
    run_offline(WallSequence(), config, tmp_path, show_progress=False)
    assert not (tmp_path / 'cloud.ply').exists()


def test_features_on_a_person_are_removed(tmp_path: Path) -> None:
    sequence = WallSequence()
    box = np.array([[0, 0, 160, 240]], np.float32)
    sequence.true_detections = {
        i * PERIOD_NS: Detections(i * PERIOD_NS, box, ('person',), np.ones(1, np.float32))
        for i in range(FRAMES)
    }
    config = RunConfig().updated({'filter.strategy': 'hoid2d', 'detector.model': TRUTH})
    summary = run_offline(sequence, config, tmp_path, show_progress=False)
    share = summary.filter.features_removed / summary.filter.features_in
    assert 0.4 < share < 0.6
    assert summary.filter.objects_dynamic == FRAMES


def test_ground_truth_boxes_need_a_recording_that_has_them(tmp_path: Path) -> None:
    config = RunConfig().updated({'detector.model': TRUTH})
    with pytest.raises(InputError, match='no ground-truth boxes'):
        run_offline(WallSequence(), config, tmp_path / 'out', show_progress=False)
    assert not (tmp_path / 'out').exists()


def test_a_map_is_saved_although_the_camera_gave_values_that_are_no_depth(tmp_path: Path) -> None:
    config = RunConfig().updated({'filter.strategy': 'none'})
    maps = MapFiles(save=tmp_path / 'wall.map')
    run_offline(StrayWall(), config, tmp_path, dense=True, maps=maps, show_progress=False)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['frames_tracked'] == FRAMES
    assert summary['ate_rmse_m'] < 0.01
    depth_m = map_file.load(tmp_path / 'wall.map').map.depth_m
    assert set(np.unique(depth_m)) == {0.0, np.float32(WALL_M)}
