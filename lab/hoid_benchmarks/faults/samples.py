"""Small intact files of each kind, which the fault cases damage."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from hoid_bags.convert import convert
from hoid_common import se3
from hoid_common.io.tum_text import write_tum
from hoid_common.values import CameraModel, Trajectory

CAMERA = CameraModel(160, 120, 150.0, 150.0, 79.5, 59.5)
NUM_FRAMES = 30
_ImagePair = tuple[NDArray[np.uint8 | np.uint16], NDArray[np.uint8 | np.uint16]]
START_NS, PERIOD_NS = 1_305_031_102_000_000_000, 33_333_333


class Samples(NamedTuple):
    """Paths of the intact files and folders."""

    tum: Path
    camera: Path
    bag: Path
    trajectory: Path


def make_samples(folder: Path) -> Samples:
    """Write one file or folder of each kind."""
    samples = Samples(*(folder / name for name in ('tum', 'camera.yaml', 'bag', 'path.txt')))
    write_tum_folder(samples.tum, _random_images(), PERIOD_NS)
    samples.camera.write_text(camera_yaml(CAMERA))
    convert(samples.tum, samples.bag, None, CAMERA)
    stamps_ns = START_NS + PERIOD_NS * np.arange(NUM_FRAMES)
    twists = 0.01 * np.random.default_rng(0).standard_normal((NUM_FRAMES, 6)).cumsum(axis=0)
    write_tum(samples.trajectory, Trajectory(stamps_ns, se3.exp(twists)))
    return samples


def _random_images() -> Iterator[_ImagePair]:
    rng = np.random.default_rng(0)
    size = CAMERA.height_px, CAMERA.width_px
    for _ in range(NUM_FRAMES):
        color = rng.integers(0, 256, (*size, 3), np.uint8)
        yield color, rng.integers(0, 13107, size).astype(np.uint16)


def write_tum_folder(folder: Path, images: Iterable[_ImagePair], period_ns: int) -> None:
    """Write a TUM folder of color images (H, W, 3) and depth images (H, W) in units of 0.2 mm."""
    lists: dict[str, list[str]] = {'rgb': [], 'depth': []}
    for kind in lists:
        (folder / kind).mkdir(parents=True)
    for i, pair in enumerate(images):
        stamp_ns = START_NS + i * period_ns
        stamp = f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}'
        for kind, image in zip(lists, pair, strict=True):
            cv2.imwrite(str(folder / kind / f'{stamp}.png'), image)
            lists[kind].append(f'{stamp} {kind}/{stamp}.png')
    for kind, rows in lists.items():
        (folder / f'{kind}.txt').write_text('\n'.join(rows) + '\n')


def camera_yaml(camera: CameraModel) -> str:
    """Return the text of a camera file."""
    matrix = {'rows': 3, 'cols': 3, 'data': camera.matrix.ravel().tolist()}
    content = {
        'image_width': camera.width_px,
        'image_height': camera.height_px,
        'camera_matrix': matrix,
        'distortion_model': 'plumb_bob',
        'distortion_coefficients': {'rows': 1, 'cols': 5, 'data': [0.0] * 5},
    }
    return str(yaml.safe_dump(content))
