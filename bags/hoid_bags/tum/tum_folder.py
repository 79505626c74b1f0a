"""Recordings in folders of images: the TUM RGB-D layout, and others (see `layouts`)."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from hoid_bags.images import check_size, decode_color, decode_depth
from hoid_bags.tum.association import MAX_PAIR_GAP_NS, pair_images
from hoid_bags.tum.cameras import CAMERA_FILE
from hoid_bags.tum.layouts import TUM, Layout, find_layout, has_file
from hoid_bags.tum.listing import Images, ListedImage
from hoid_common.errors import ConfigError, InputError, MessageError, prefixed
from hoid_common.inputs.registration import DepthAligner
from hoid_common.io.depth import DepthUnitWarning, check_depth_unit, readings_m
from hoid_common.io.images import depth_m_from_units
from hoid_common.values import CameraModel, RgbdFrame, Trajectory

_LOG = logging.getLogger(__name__)
REGISTER_FILES = 'register the files to color'


@dataclass(frozen=True)
class TumFolder:
    """A recording in a folder of images; iterating it yields its paired images.

    It has all members of the protocol `hoid_bags.sequence.Sequence`.
    """

    path: Path
    camera: CameraModel
    depth_units_per_m: float  # depth units per meter in the PNG files
    color: Images  # all color images
    depth: Images  # all depth images
    max_gap_ns: int = MAX_PAIR_GAP_NS
    depth_offset_ns: int = 0  # time by which the stamps of depth images are too late
    layout: Layout = TUM
    fault: None = None  # reading damaged files raises an error instead
    true_detections: None = None

    def __str__(self) -> str:
        """Return a line about the files that were chosen; empty for the usual layout, TUM."""
        layout, camera = self.layout, self.camera
        if layout is TUM:
            return ''
        truth = layout.truth_path(self.path)
        names = dict.fromkeys((layout.gyro, layout.accelerometer))
        others = [f'truth {truth.name}'] if truth is not None else []
        others += [f'IMU {name}' for name in names if name and has_file(self.path, name)]
        others += [layout.note] if layout.note else []
        return (
            f'{layout.name} layout: color {layout.color} ({len(self.color)}), depth '
            f'{layout.depth} ({len(self.depth)}, {self.depth_units_per_m:g} units per meter), '
            f'camera {camera.width_px}x{camera.height_px} fx {camera.fx_px:.1f}'
            f'{"".join(f", {text}" for text in others)}'
        )

    @property
    def name(self) -> str:
        return self.path.name

    @cached_property
    def ground_truth(self) -> Trajectory | None:
        """Return the poses; None if the file is missing or, with a warning, unusable."""
        path = self.layout.truth_path(self.path)
        try:
            return self.layout.read_truth(path) if path is not None else None
        except InputError as error:
            _LOG.warning('%s; errors are not computed', error)
            return None

    @cached_property
    def pairs(self) -> tuple[tuple[ListedImage, ListedImage], ...]:
        """Return the pairs (color, depth) of images, in order of time (see `pair_images`)."""
        color_ns, depth_ns = (
            np.array([image.stamp_ns for image in images], np.int64)
            for images in (self.color, self.depth)
        )
        pairs = pair_images(color_ns, depth_ns, self.max_gap_ns, self.depth_offset_ns, self.path)
        return tuple((self.color[i], self.depth[j]) for i, j in pairs.tolist())

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[RgbdFrame]:
        unit, aligner = DepthUnitWarning('set --depth-factor'), DepthAligner(REGISTER_FILES)
        for color, depth in self.pairs:
            image_bgr = decode_color(color.load(), color.path)
            check_size(image_bgr, self.camera, color.path)
            units = decode_depth(depth.load(), depth.path)
            depth_m = depth_m_from_units(units, self.depth_units_per_m)
            with prefixed(f'{depth.path}: ', InputError, MessageError):
                check_depth_unit(depth_m, f'1/{self.depth_units_per_m:g} m; set --depth-factor')
                depth_m = aligner.align(depth_m, '', '', self.camera.size_px)
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
    """Open a recording in files, and check its lists; for all arguments see `open_sequence`.

    InputError if a file is missing or unusable, the camera is unknown, or no images make a pair.
    ConfigError if the depth units are not positive, or a list names an impossible file.

    Args:
        camera: Camera of the recording; None: the one that its files state or, for TUM, that
            of camera.yaml or the published one whose name the folder's name contains.
    """
    if depth_units_per_m is not None and not 0 < depth_units_per_m < np.inf:
        raise ConfigError(f'depth units per meter must be positive, got {depth_units_per_m}')
    if not path.exists():
        raise InputError(f'{path}: no such folder')
    layout = find_layout(path) or TUM
    color, depth = layout.read_images(path, layout.color, layout.depth)
    stated = layout.read_camera(path) if camera is None or depth_units_per_m is None else None
    camera = camera or (stated.camera if stated else None)
    if camera is None:
        raise InputError(
            f'{path}: no {CAMERA_FILE}, and the name contains no known camera;'
            ' give --calibration fr1, fr2, fr3, bonn or a YAML file'
        )
    units_per_m = depth_units_per_m or (stated.units_per_m if stated else 0) or layout.units_per_m
    folder = TumFolder(
        path, camera, units_per_m, color, depth, max_gap_ns, depth_offset_ns, layout
    )
    _ = folder.pairs, folder.ground_truth  # their warnings come before the work, not after it
    return folder
