"""Recordings in folders of images: the TUM RGB-D layout, and others (see `layouts`)."""

from __future__ import annotations

import logging
import re
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
    read_image_bytes,
)
from hoid_bags.tum.association import MAX_PAIR_GAP_NS, pair_images
from hoid_bags.tum.layouts import TUM, Layout, find_layout, numbered_stamp_ns
from hoid_common.errors import ConfigError, InputError, MessageError
from hoid_common.inputs.registration import DepthAligner
from hoid_common.io.depth import DepthUnitWarning, check_depth_unit, readings_m
from hoid_common.io.images import depth_m_from_units
from hoid_common.io.tum_text import NumberTable, read_numbers, sorted_rows
from hoid_common.io.untrusted import check_path_name
from hoid_common.values import CameraModel, IntArray, RgbdFrame, Trajectory

_LOG = logging.getLogger(__name__)
_SUFFIXES = ('.jpg', '.jpeg', '.png')
REGISTER_FILES = 'register the files to color'


class ListedImage(NamedTuple):
    """One color or depth image."""

    stamp_ns: int
    path: Path


@dataclass(frozen=True)
class TumFolder:
    """A recording in a folder of images; iterating it yields its paired images.

    It has all members of the protocol `hoid_bags.sequence.Sequence`.
    """

    path: Path
    camera: CameraModel
    depth_units_per_m: float  # depth units per meter in the PNG files
    color: tuple[ListedImage, ...]  # all color images
    depth: tuple[ListedImage, ...]  # all depth images
    max_gap_ns: int = MAX_PAIR_GAP_NS
    depth_offset_ns: int = 0  # time by which the stamps of depth images are too late
    layout: Layout = TUM

    def __str__(self) -> str:
        """Return a line of text: what was taken for what; empty for the usual layout, TUM."""
        layout, camera = self.layout, self.camera
        if layout is TUM:
            return ''
        names = (layout.truth, layout.gyro, layout.accelerometer)
        others = [name for name in names if name and (self.path / name).exists()]
        stamps = ', stamps of an assumed 30 Hz' if layout.is_numbered else ''
        return (
            f'{layout.name} layout: color {layout.color} ({len(self.color)}), depth '
            f'{layout.depth} ({len(self.depth)}, {self.depth_units_per_m:g} units per meter), '
            f'camera {camera.width_px}x{camera.height_px} fx {camera.fx_px:.1f}{stamps}'
            f'{"".join(f", {name}" for name in others)}'
        )

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
        """Return the ground-truth poses; the trajectory is empty if their file has no rows.

        The result is None if the file is missing. It is also None, with a warning in the log, if
        the file cannot be read, or has rows and none of them is a pose.
        """
        path = self.path / self.layout.truth
        try:
            return self.layout.read_truth(path) if path.is_file() else None
        except InputError as error:
            _LOG.warning('%s; errors are not computed', error)
            return None

    @cached_property
    def accelerometer(self) -> NumberTable | None:
        """Return accelerations (N, 3) in m/s^2; None: there are none.

        Raises:
            InputError: The file cannot be read, or has rows and none of them is usable.
        """
        path = self.path / self.layout.accelerometer
        return read_numbers(path, columns=3) if path.exists() else None

    @cached_property
    def gyro(self) -> NumberTable | None:
        """Return angular velocities (N, 3) in rad/s; None: there are none.

        Raises:
            InputError: The file cannot be read, or has rows and none of them is usable.
        """
        path = self.path / self.layout.gyro
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
    depth_units_per_m: float | None = None,
    max_gap_ns: int = MAX_PAIR_GAP_NS,
    depth_offset_ns: int = 0,
) -> TumFolder:
    """Open a folder of images, and check its lists of images.

    Args:
        path: The folder.
        camera: Camera of the recording; None: the one that the layout states or, for TUM, the
            published camera whose name the folder's name contains.
        depth_units_per_m: Depth units per meter in the files; None: those of the layout.
        max_gap_ns: A color and a depth image make a pair only if their stamps differ by less.
        depth_offset_ns: Time by which the stamps of depth images are too late; it is subtracted
            before pairing.

    Raises:
        InputError: A list is missing, unreadable or empty, or names a missing file; the camera is
            unknown; or no images make a pair.
        ConfigError: The depth units are not positive, or a list contains a file name that no file
            can have.
    """
    if depth_units_per_m is not None and not 0 < depth_units_per_m < np.inf:
        raise ConfigError(f'depth units per meter must be positive, got {depth_units_per_m}')
    if not path.is_dir():
        raise InputError(f'{path}: no such folder')
    layout = find_layout(path) or TUM
    read = _read_numbered if layout.is_numbered else _read_list
    color, depth = (read(path, name) for name in (layout.color, layout.depth))
    stated = layout.read_camera(path) if camera is None or depth_units_per_m is None else None
    camera = camera or (stated.camera if stated else None)
    if camera is None:
        raise InputError(
            f'{path}: the name contains no known camera;'
            ' give --calibration fr1, fr2, fr3, bonn or a YAML file'
        )
    units_per_m = depth_units_per_m or (stated.units_per_m if stated else 0) or layout.units_per_m
    folder = TumFolder(
        path, camera, units_per_m, color, depth, max_gap_ns, depth_offset_ns, layout
    )
    _ = folder.pairs, folder.ground_truth  # their warnings come before the work, not after it
    return folder


def _read_numbered(folder: Path, pattern: str) -> tuple[ListedImage, ...]:
    """Return the images whose names end with a number, in order of it."""
    numbers = {
        int(match[1]): path
        for path in folder.glob(pattern)
        if (match := re.search(r'(\d+)$', path.stem)) and path.suffix.lower() in _SUFFIXES
    }
    if not numbers:
        raise InputError(f'{folder}: has no images {pattern}')
    return tuple(ListedImage(numbered_stamp_ns(n), numbers[n]) for n in sorted(numbers))


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
