"""Recordings in the TUM RGB-D layout: `rgb.txt` and `depth.txt` list the images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.images import (
    check_size,
    decode_color,
    decode_depth,
    depth_m_from_units,
    read_image_bytes,
)
from hoid_bags.tum.association import associate
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, camera_from_name
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.trajectory_io import read_tum
from hoid_common.io.tum_text import (
    NumberTable,
    check_increasing,
    read_numbers,
    read_rows,
    without_duplicates,
)
from hoid_common.io.untrusted import check_path_name
from hoid_common.values import CameraModel, RgbdFrame, Trajectory

COLOR_LIST = 'rgb.txt'
DEPTH_LIST = 'depth.txt'
GROUND_TRUTH = 'groundtruth.txt'
ACCELEROMETER = 'accelerometer.txt'


class ListedImage(NamedTuple):
    """One entry of rgb.txt or depth.txt."""

    stamp_ns: int
    path: Path


@dataclass(frozen=True)
class TumFolder:
    """A TUM folder with verified lists; a `Sequence` of its paired images."""

    path: Path
    camera: CameraModel
    depth_units_per_m: float
    color: tuple[ListedImage, ...]
    depth: tuple[ListedImage, ...]

    @property
    def name(self) -> str:
        """Return the folder's name."""
        return self.path.name

    @property
    def fault(self) -> str | None:
        """Return None, because reading a damaged folder raises an error instead."""
        return None

    @property
    def true_detections(self) -> None:
        """Return None, because the layout has no detections."""
        return None

    @cached_property
    def ground_truth(self) -> Trajectory | None:
        """Return the poses of `groundtruth.txt`, or None without the file."""
        path = self.path / GROUND_TRUTH
        return read_tum(path) if path.exists() else None

    @cached_property
    def accelerometer(self) -> NumberTable | None:
        """Return the (N, 3) accelerations in m/s^2 of `accelerometer.txt`, or None without it."""
        path = self.path / ACCELEROMETER
        return read_numbers(path, columns=3) if path.exists() else None

    @cached_property
    def pairs(self) -> tuple[tuple[ListedImage, ListedImage], ...]:
        """Return the pairs of color and depth images with nearly equal stamps."""
        stamps = [
            np.array([image.stamp_ns for image in images], np.int64)
            for images in (self.color, self.depth)
        ]
        return tuple(
            (self.color[i], self.depth[j])
            for i, j in associate(stamps[0], stamps[1], source=self.path).tolist()
        )

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[RgbdFrame]:
        for color, depth in self.pairs:
            image_bgr = decode_color(read_image_bytes(color.path), color.path)
            check_size(image_bgr, self.camera, color.path)
            units = decode_depth(read_image_bytes(depth.path), depth.path)
            check_size(units, self.camera, depth.path)
            yield RgbdFrame(
                color.stamp_ns, image_bgr, depth_m_from_units(units, self.depth_units_per_m)
            )


def open_tum_folder(
    path: Path, camera: CameraModel | None = None, depth_units_per_m: float = TUM_DEPTH_UNITS_PER_M
) -> TumFolder:
    """Open a TUM folder; without `camera`, its name must contain that of a published camera.

    Raises:
        InputError: A list is missing, empty or out of order, or names a missing file.
        ConfigError: The depth factor is not positive.
    """
    if not (np.isfinite(depth_units_per_m) and depth_units_per_m > 0):
        raise ConfigError(f'depth units per meter must be positive, got {depth_units_per_m}')
    if not path.is_dir():
        raise InputError(f'{path}: no such folder')
    color, depth = (_read_list(path, name) for name in (COLOR_LIST, DEPTH_LIST))
    camera = camera or camera_from_name(path.resolve().name)
    if camera is None:
        raise InputError(
            f'{path}: the name contains no known camera;'
            ' give --camera fr1, fr2, fr3, bonn or a YAML file'
        )
    folder = TumFolder(path, camera, depth_units_per_m, color, depth)
    if not folder.pairs:
        raise InputError(
            f'{path}: no color and depth images within 0.02 s of each other; check both lists'
        )
    return folder


def _read_list(folder: Path, name: str) -> tuple[ListedImage, ...]:
    path = folder / name
    rows = list(read_rows(path))
    if not rows:
        raise InputError(f'{path}: lists no images')
    rows = without_duplicates(rows)
    check_increasing(path, rows)
    for row in rows:
        check_path_name(str(folder / row.text), f'{path}: line {row.line}')
        if not row.text or not (folder / row.text).is_file():
            raise InputError(f'{path}: line {row.line}: lists "{row.text}", which does not exist')
    return tuple(ListedImage(row.stamp_ns, folder / row.text) for row in rows)
