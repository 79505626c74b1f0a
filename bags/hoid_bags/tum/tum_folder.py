"""Recordings in the TUM RGB-D layout: `rgb.txt` and `depth.txt` list the images."""

from __future__ import annotations

import logging
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
from hoid_bags.tum.association import MAX_PAIR_GAP_NS, pair_images
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, camera_from_name
from hoid_common.errors import ConfigError, InputError, MessageError
from hoid_common.inputs.registration import DepthAligner
from hoid_common.io.depth import DepthUnitWarning, check_depth_unit, readings_m
from hoid_common.io.trajectory_io import read_tum
from hoid_common.io.tum_text import NumberTable, read_numbers, sorted_rows
from hoid_common.io.untrusted import check_path_name
from hoid_common.values import CameraModel, IntArray, RgbdFrame, Trajectory

_LOG = logging.getLogger(__name__)
COLOR_LIST = 'rgb.txt'
DEPTH_LIST = 'depth.txt'
GROUND_TRUTH = 'groundtruth.txt'
ACCELEROMETER = 'accelerometer.txt'
GYRO = 'gyro.txt'
REGISTER_FILES = 'register the files to color'


class ListedImage(NamedTuple):
    """One entry of rgb.txt or depth.txt."""

    stamp_ns: int
    path: Path


@dataclass(frozen=True)
class TumFolder:
    """A recording in the TUM layout; iterating it yields its paired images.

    It has all members of the protocol `hoid_bags.sequence.Sequence`.
    """

    path: Path
    camera: CameraModel
    depth_units_per_m: float  # depth units per meter in the PNG files
    color: tuple[ListedImage, ...]  # all entries of rgb.txt
    depth: tuple[ListedImage, ...]  # all entries of depth.txt
    max_gap_ns: int = MAX_PAIR_GAP_NS
    depth_offset_ns: int = 0  # time by which the stamps of depth images are too late

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
        """Return the poses of `groundtruth.txt`; the trajectory is empty if the file has no rows.

        The result is None if the file is missing. It is also None, with a warning in the log, if
        the file cannot be read, or has rows and none of them is a pose.
        """
        path = self.path / GROUND_TRUTH
        try:
            return read_tum(path) if path.exists() else None
        except InputError as error:
            _LOG.warning('%s; errors are not computed', error)
            return None

    @cached_property
    def accelerometer(self) -> NumberTable | None:
        """Return accelerations (N, 3) in m/s^2; None if there is no `accelerometer.txt`.

        Raises:
            InputError: The file cannot be read, or has rows and none of them is usable.
        """
        path = self.path / ACCELEROMETER
        return read_numbers(path, columns=3) if path.exists() else None

    @cached_property
    def gyro(self) -> NumberTable | None:
        """Return angular velocities (N, 3) in rad/s; None if there is no `gyro.txt`.

        Raises:
            InputError: The file cannot be read, or has rows and none of them is usable.
        """
        path = self.path / GYRO
        return read_numbers(path, columns=3) if path.exists() else None

    @cached_property
    def pairs(self) -> tuple[tuple[ListedImage, ListedImage], ...]:
        """Return the pairs (color, depth) of images, in order of time.

        Their stamps differ by less than `max_gap_ns` after `depth_offset_ns` is subtracted from
        that of the depth image.

        Raises:
            InputError: No images make a pair, or the stamps are too close to each other.
        """
        pairs = pair_images(
            self.color_ns, self.depth_ns, self.max_gap_ns, self.depth_offset_ns, self.path
        )
        return tuple((self.color[i], self.depth[j]) for i, j in pairs.tolist())

    @property
    def color_ns(self) -> IntArray:
        """Return the stamps (N,) of the color images in ns."""
        return np.array([image.stamp_ns for image in self.color], np.int64)

    @property
    def depth_ns(self) -> IntArray:
        """Return the stamps (N,) of the depth images in ns."""
        return np.array([image.stamp_ns for image in self.depth], np.int64)

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[RgbdFrame]:
        unit, aligner = DepthUnitWarning('set --depth-factor'), DepthAligner(REGISTER_FILES)
        for color, depth in self.pairs:
            image_bgr = decode_color(read_image_bytes(color.path), color.path)
            check_size(image_bgr, self.camera, color.path)
            units = decode_depth(read_image_bytes(depth.path), depth.path)
            depth_m = depth_m_from_units(units, self.depth_units_per_m)
            try:
                check_depth_unit(depth_m, f'1/{self.depth_units_per_m:g} m; set --depth-factor')
                depth_m = aligner.align(depth_m, '', '', self.camera.size_px)
            except MessageError as error:
                raise InputError(f'{depth.path}: {error}') from error
            if warning := unit.warning_for(depth_m):
                _LOG.warning('%s: %s', self.path, warning)
            yield RgbdFrame(color.stamp_ns, image_bgr, readings_m(depth_m))


def open_tum_folder(
    path: Path,
    camera: CameraModel | None = None,
    depth_units_per_m: float = TUM_DEPTH_UNITS_PER_M,
    max_gap_ns: int = MAX_PAIR_GAP_NS,
    depth_offset_ns: int = 0,
) -> TumFolder:
    """Open a TUM folder, and check its lists of images.

    Args:
        path: The folder.
        camera: Camera of the recording; None: the published camera whose name the folder's name
            contains.
        depth_units_per_m: Depth units per meter in the PNG files.
        max_gap_ns: A color and a depth image make a pair only if their stamps differ by less.
        depth_offset_ns: Time by which the stamps of depth images are too late; it is subtracted
            before pairing.

    Raises:
        InputError: A list is missing, unreadable or empty, or names a missing file; the camera is
            unknown; or no images make a pair.
        ConfigError: The depth units are not positive, or a list contains a file name that no file
            can have.
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
            ' give --calibration fr1, fr2, fr3, bonn or a YAML file'
        )
    folder = TumFolder(path, camera, depth_units_per_m, color, depth, max_gap_ns, depth_offset_ns)
    _ = folder.pairs, folder.ground_truth  # their warnings come before the work, not after it
    return folder


def _read_list(folder: Path, name: str) -> tuple[ListedImage, ...]:
    path = folder / name
    rows = sorted_rows(path)
    if not rows:
        raise InputError(f'{path}: lists no images')
    for row in rows:
        check_path_name(str(folder / row.text), f'{path}: line {row.line}')
        if not row.text or not (folder / row.text).is_file():
            raise InputError(f'{path}: line {row.line}: lists "{row.text}", which does not exist')
    return tuple(ListedImage(row.stamp_ns, folder / row.text) for row in rows)
