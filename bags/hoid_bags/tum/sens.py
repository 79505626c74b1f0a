"""ScanNet's `.sens` files: color, depth, poses and rates of a structured-light scanner.

Format: https://github.com/ScanNet/ScanNet/tree/master/SensReader. Depth is registered to color by
the calibration in the file.
"""

from __future__ import annotations

import logging
import os
import struct
import zlib
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from hoid_bags.tum import listing
from hoid_bags.tum.listing import FolderCamera, Images, ListedImage
from hoid_common import se3
from hoid_common.errors import InputError, replaced_by
from hoid_common.inputs.registration import Registration
from hoid_common.io.images import depth_m_from_units
from hoid_common.io.stamps import END_STAMP_NS, in_order
from hoid_common.io.tum_text import NumberTable
from hoid_common.io.untrusted import open_regular
from hoid_common.values import Float32Array, FloatArray, IntArray, Trajectory

_LOG = logging.getLogger(__name__)
SUFFIX = '.sens'
_VERSION = 4
_HEAD = np.dtype(
    [
        ('matrices', '<f4', (4, 4, 4)),  # K and T_device_camera of color, then of depth
        ('kinds', '<i4', 2),  # compression of color and depth
        ('sizes_px', '<u4', (2, 2)),
        ('units_per_m', '<f4'),
        ('num_frames', '<u8'),
    ]
)
_FRAME = struct.Struct('<16f4Q')  # T_world_camera, stamps (us) and bytes of color and depth
_RATES = np.dtype([('rate_radps', '<f8', 3), ('others', 'V96'), ('stamp_us', '<u8')])
_JPEG_OR_PNG = (1, 2)
_RAW_DEPTH, _ZLIB_DEPTH = 0, 1
_MAX_NAME_BYTES = 4096  # chosen: longest name of the sensor
_NS_PER_US = 1000


class _Frame(NamedTuple):
    """One frame: its pose, and the positions of its images in the file."""

    T_world_camera: FloatArray  # (4, 4); not finite: the scanner had lost tracking
    stamp_us: int
    color_at: int
    color_bytes: int
    depth_bytes: int  # depth follows color


class SensFile:
    """The content of a `.sens` file, without the images.

    InputError: the header is truncated, or the version or compression is not ScanNet's.
    """

    def __init__(self, path: Path) -> None:
        self.path = path if path.suffix == SUFFIX else next(iter(sorted(path.glob(f'*{SUFFIX}'))))
        self.frames: list[_Frame] = []
        self.rates = np.empty(0, _RATES)
        problem = InputError(f'{self.path}: damaged, or no recording of ScanNet')
        with (
            open_regular(self.path) as file,
            replaced_by(problem, struct.error, ValueError, OverflowError),
        ):
            self.num_frames = self._read_head(file)
            self._read_frames(file)

    def _read_head(self, file: BinaryIO) -> int:
        version, length = struct.unpack('<IQ', file.read(12))
        if version != _VERSION or length > _MAX_NAME_BYTES:
            raise InputError(f'{self.path}: no recording of ScanNet of version {_VERSION}')
        file.seek(length, os.SEEK_CUR)
        (head,) = np.frombuffer(file.read(_HEAD.itemsize), _HEAD)
        color, depth = head['kinds'].tolist()
        if color not in _JPEG_OR_PNG or depth not in (_RAW_DEPTH, _ZLIB_DEPTH):
            raise InputError(f'{self.path}: color {color} or depth {depth} is of an unknown kind')
        self.is_packed, self.units_per_m = depth == _ZLIB_DEPTH, float(head['units_per_m'])
        matrices, sizes_px = head['matrices'].astype(float), head['sizes_px'].tolist()
        self.depth_camera = listing.matrix_camera(self.path, sizes_px[1], matrices[2])
        full = listing.matrix_camera(self.path, sizes_px[0], matrices[0])
        # Color has about twice the size of depth, but is cropped differently.
        halves = max(1, round(full.width_px / self.depth_camera.width_px))
        size_px = full.width_px // halves, full.height_px // halves
        self.camera = listing.resized_camera(full, size_px)
        self.T_color_depth = se3.inverse(matrices[1]) @ matrices[3]
        return int(head['num_frames'])

    def _read_frames(self, file: BinaryIO) -> None:
        """Read the heads of the complete frames, and the angular velocities after them."""
        size = os.fstat(file.fileno()).st_size
        for _ in range(self.num_frames):
            head = file.read(_FRAME.size)
            if len(head) < _FRAME.size:
                return
            *pose, stamp_us, _, color_bytes, depth_bytes = _FRAME.unpack(head)
            at = file.tell()
            if at + color_bytes + depth_bytes > size:
                return
            T = np.array(pose).reshape(4, 4)
            self.frames.append(_Frame(T, stamp_us, at, color_bytes, depth_bytes))
            file.seek(color_bytes + depth_bytes, os.SEEK_CUR)
        if len(count := file.read(8)) == 8:
            (number,) = struct.unpack('<Q', count)
            data = file.read(min(number * _RATES.itemsize, size))
            whole = data[: len(data) // _RATES.itemsize * _RATES.itemsize]
            self.rates = np.frombuffer(whole, _RATES)

    @property
    def stamps_ns(self) -> IntArray:
        """Return the stamps (N,) of the frames, at an assumed 30 Hz if the file has none."""
        stamps_ns = [frame.stamp_us * _NS_PER_US for frame in self.frames]
        is_rising = all(a < b for a, b in pairwise(stamps_ns))
        if not is_rising or not 0 < max(stamps_ns, default=0) < END_STAMP_NS:
            stamps_ns = [listing.numbered_stamp_ns(i) for i in range(len(stamps_ns))]
        return np.array(stamps_ns, np.int64)

    def part(self, offset: int, size: int) -> bytes:
        with open_regular(self.path) as file:
            file.seek(offset)
            return file.read(size)

    def depth_m(self, frame: _Frame, register: Registration) -> Float32Array:
        """Return the (H, W) depth of a frame in m at the pixels of color."""
        data = self.part(frame.color_at + frame.color_bytes, frame.depth_bytes)
        width, height = self.depth_camera.size_px
        with replaced_by(InputError(f'{self.path}: damaged depth image'), zlib.error, ValueError):
            if self.is_packed:
                data = zlib.decompressobj().decompress(data, 2 * width * height)
            units = np.frombuffer(data, '<u2').reshape(height, width)
        return register(depth_m_from_units(units, self.units_per_m))


def sens_camera(path: Path) -> FolderCamera:
    return FolderCamera(SensFile(path).camera)


def sens_images(path: Path, _color: str, _depth: str) -> tuple[Images, Images]:
    """Return the color images, at about the size of depth, and depth mapped to them."""
    source = SensFile(path)
    stamps_ns = source.stamps_ns.tolist()
    register = Registration(source.depth_camera, source.camera, source.T_color_depth)
    if not stamps_ns:
        raise InputError(f'{source.path}: has no frames')
    if len(stamps_ns) < source.num_frames:
        _LOG.warning('%s: cut off after %d frames', source.path, len(stamps_ns))
    colors, depths = [], []
    for stamp_ns, frame in zip(stamps_ns, source.frames, strict=True):
        read = partial(source.part, frame.color_at, frame.color_bytes)
        color = ListedImage(stamp_ns, source.path, read)
        colors.append(listing.resized_color(color, source.camera.size_px))
        depths.append(ListedImage(stamp_ns, source.path, partial(source.depth_m, frame, register)))
    return tuple(colors), tuple(depths)


def sens_truth(path: Path) -> Trajectory:
    """Return the poses of the frames that the scanner tracked."""
    source = SensFile(path)
    T = np.array([frame.T_world_camera for frame in source.frames]).reshape(-1, 4, 4)
    return listing.rigid_poses(source.stamps_ns, T)


def sens_imu(path: Path) -> tuple[NumberTable | None, None]:
    """Return the angular velocities (rad/s); accelerations have no documented unit."""
    rates = SensFile(path).rates
    rates = rates[rates['stamp_us'] < END_STAMP_NS // _NS_PER_US]
    if not len(rates):
        return None, None
    order = in_order(rates['stamp_us'].astype(np.int64) * _NS_PER_US)
    return NumberTable(order.stamps_ns, rates['rate_radps'][order.positions].astype(float)), None
