"""Small TUM folders and bags, which tests read and damage."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hoid_bags.convert import convert
from hoid_common.values import CameraModel

SIZE = (32, 24)  # width, height
START_NS = 1_305_031_102_175_304_123  # nanoseconds that a float64 of seconds cannot hold
PERIOD_NS = 33_333_333
DEPTH_LAG_NS = -5_000_001

FolderMaker = Callable[..., Path]


@pytest.fixture
def camera() -> CameraModel:
    return CameraModel(*SIZE, 30.0, 31.0, 15.5, 11.5, (0.1, -0.2, 0.001, -0.002, 0.05))


@pytest.fixture(scope='session')
def big_camera() -> CameraModel:
    """Return the camera of folders with scale 5, of which eleven frames fill a chunk of a bag."""
    return CameraModel(5 * SIZE[0], 5 * SIZE[1], 150.0, 155.0, 77.5, 57.5)


def write_folder(
    folder: Path, num_frames: int, *, ext: str = 'png', depth_step: int = 1, scale: int = 1
) -> Path:
    """Write a folder of N frames with smooth color and random depth images."""
    rng = np.random.default_rng(num_frames)
    width, height = SIZE[0] * scale, SIZE[1] * scale
    lists: dict[str, list[str]] = {'rgb': [], 'depth': []}
    for kind in lists:
        (folder / kind).mkdir(parents=True)
    for i in range(num_frames):
        color_ns = START_NS + i * PERIOD_NS
        patches = rng.integers(0, 256, (3, 4, 3), np.uint8)
        color = cv2.resize(patches, (width, height), interpolation=cv2.INTER_LINEAR)
        depth = rng.integers(0, 13107, (height, width)).astype(np.uint16) * depth_step
        for kind, stamp_ns, pixels, suffix in (
            ('rgb', color_ns, color, ext),
            ('depth', color_ns + DEPTH_LAG_NS, depth, 'png'),
        ):
            stamp = f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}'
            cv2.imwrite(str(folder / kind / f'{stamp}.{suffix}'), pixels)
            lists[kind].append(f'{stamp} {kind}/{stamp}.{suffix}')
    for kind, lines in lists.items():
        text = '\n'.join(['# images', '# timestamp filename', *lines]) + '\n'
        (folder / f'{kind}.txt').write_text(text)
    return folder


@pytest.fixture
def make_folder(tmp_path: Path) -> FolderMaker:
    """Return a function that makes a folder of N frames."""

    def make(num_frames: int = 3, *, name: str = 'fr1_small', **options: Any) -> Path:
        return write_folder(tmp_path / name, num_frames, **options)

    return make


@pytest.fixture(scope='session')
def whole_bag(tmp_path_factory: pytest.TempPathFactory, big_camera: CameraModel) -> Path:
    """Return a bag of 60 frames in six chunks, which tests must not change."""
    folder = tmp_path_factory.mktemp('whole')
    convert(write_folder(folder / 'tum', 60, scale=5), folder / 'bag', None, big_camera)
    return folder / 'bag'


@pytest.fixture
def bag(whole_bag: Path, tmp_path: Path) -> Path:
    """Return a copy of `whole_bag` that a test may damage."""
    return shutil.copytree(whole_bag, tmp_path / 'bag')


@pytest.fixture
def with_truth() -> Callable[[Path], Path]:
    """Return a function that adds ground truth and accelerometer to a folder."""

    def add(folder: Path) -> Path:
        (folder / 'groundtruth.txt').write_text(
            '# timestamp tx ty tz qx qy qz qw\n'
            '1305031102.1753 1.5 -0.25 2.0 0.0 0.0 0.7071 0.7071\n'
            '1305031102.2000 1.6 -0.25 2.0 0.6132 0.5962 -0.3311 -0.3986\n'
        )
        (folder / 'accelerometer.txt').write_text(
            '# accelerometer data\n1305031102.176000001 -0.478957 8.010560 -4.166928\n'
        )
        return folder

    return add
