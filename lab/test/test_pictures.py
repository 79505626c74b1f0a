from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from hoid_benchmarks.animation import write_animation
from hoid_benchmarks.map_animation import draw_growing_maps
from hoid_benchmarks.pictures import draw_scenes, frame_numbers, write_sheets
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import ConfigError, InputError
from hoid_common.values import CameraModel, Detections, ObjectState, RgbdFrame, Trajectory
from hoid_filter.config import FilterConfig
from hoid_filter.drawing import KEPT_BGR, REASON_BGR, REMOVED_BGR

HEIGHT, WIDTH = 240, 320
PERSON = (100.0, 60.0, 180.0, 220.0)
CUP = (150.0, 100.0, 190.0, 140.0)  # a person covers 3/4 of it


class Recording:
    """Two gray frames with texture, a person at 2 m and a cup in front of it at 1 m."""

    name = 'two'
    camera = CameraModel(WIDTH, HEIGHT, 250.0, 250.0, 160.0, 120.0)
    ground_truth: Trajectory | None = None
    true_detections = None
    fault = None

    def __len__(self) -> int:
        return 2

    def __iter__(self) -> Iterator[RgbdFrame]:
        grain = np.random.default_rng(0).integers(0, 256, (HEIGHT // 8, WIDTH // 8), np.uint8)
        gray = np.asarray(cv2.resize(grain, (WIDTH, HEIGHT)), np.uint8)
        image = np.dstack([gray, gray, gray])
        depth_m = np.full((HEIGHT, WIDTH), 2.0, np.float32)
        depth_m[100:140, 150:190] = 1.0
        for n in range(2):
            yield RgbdFrame(n * 33_000_000, image, depth_m)


def seen(frame: RgbdFrame) -> Detections:
    boxes = np.array([PERSON, CUP], np.float32)
    return Detections(frame.stamp_ns, boxes, ('person', 'cup'), np.full(2, 0.9, np.float32))


def has_color(picture: np.ndarray, x: int, y: int, bgr: tuple[int, int, int]) -> bool:
    return bool((picture[y, x] == bgr).all())


def num_pixels(picture: np.ndarray, bgr: tuple[int, int, int]) -> int:
    return int(np.count_nonzero((picture == bgr).all(axis=2)))


def num_kept(picture: np.ndarray, area: tuple[slice, slice]) -> int:
    return num_pixels(picture[area], KEPT_BGR)


def test_pictures_show_the_verdict_of_each_rule() -> None:
    config = FilterConfig(strategy='hoid2d')
    ((number, scene),) = draw_scenes(Recording(), [1], seen, config)
    assert number == 1
    assert has_color(scene.verdict, 100, 180, REASON_BGR[ObjectState.PERSON])
    assert has_color(scene.verdict, 189, 120, REASON_BGR[ObjectState.HANDLED])
    assert has_color(scene.kept_2d, 189, 120, REASON_BGR[ObjectState.HANDLED])
    assert has_color(scene.kept_3d, 189, 120, REASON_BGR[ObjectState.AT_REST])
    body, right = np.s_[150:210, 110:170], np.s_[104:136, 182:187]
    assert num_kept(scene.everything, body) > 0
    assert num_kept(scene.kept_2d, body) == 0
    assert num_kept(scene.kept_2d, right) == 0
    assert num_kept(scene.kept_3d, right) > 0


def test_sheets_are_written(tmp_path: Path) -> None:
    scenes = [scene for _, scene in draw_scenes(Recording(), [0, 1], seen, FilterConfig())]
    paths = write_sheets(scenes, [0, 1], 'hoid+', tmp_path / 'new')
    sizes = {path.stem: np.asarray(cv2.imread(str(path))).shape[:2] for path in paths}
    assert sizes == {'verdicts': (318, 640), 'features': (318, 640), 'rules': (584, 640)}


def test_frames_are_requested_or_spread() -> None:
    assert frame_numbers(None, 101) == [25, 50, 75]
    assert frame_numbers(None, 1) == [0]
    assert frame_numbers([7, 3, 7], 10) == [7, 3]
    with pytest.raises(ConfigError, match='--frames 10: the recording has frames 0 to 9'):
        frame_numbers([10], 10)
    with pytest.raises(InputError, match='no frames'):
        frame_numbers(None, 0)


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    scenes = [scene for _, scene in draw_scenes(Recording(), [0], seen, FilterConfig())]
    with pytest.raises(InputError, match='file'):
        write_sheets(scenes, [0], 'hoid+', tmp_path / 'file')


def test_the_map_without_a_filter_has_the_features_that_the_filter_removes(tmp_path: Path) -> None:
    drawn = list(draw_growing_maps(Recording(), seen, RunConfig()))
    assert len(drawn) == 2
    without, filtered = drawn[-1][: HEIGHT // 2, WIDTH:], drawn[-1][HEIGHT // 2 : HEIGHT, WIDTH:]
    assert without.shape == filtered.shape == (HEIGHT // 2, WIDTH // 2, 3)
    assert num_pixels(without, REMOVED_BGR) > 0
    assert num_pixels(filtered, REMOVED_BGR) == 0
    assert num_pixels(filtered, KEPT_BGR) > 0

    write_animation(tmp_path / 'a.webp', drawn, width_px=240, frame_ms=400)
    with Image.open(tmp_path / 'a.webp') as animation:
        assert (animation.size[0], getattr(animation, 'n_frames', 1)) == (240, 2)
