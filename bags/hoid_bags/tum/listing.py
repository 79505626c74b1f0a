"""Images of a recording in files, and the text and JSON files that describe them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from hoid_bags.images import ImageData, decode_color, read_image_bytes
from hoid_common import se3
from hoid_common.errors import ConfigError, InputError, prefixed, replaced_by
from hoid_common.io.tum_text import sorted_rows
from hoid_common.io.untrusted import check_path_name, read_text
from hoid_common.values import (
    NS_PER_S,
    ByteArray,
    CameraModel,
    FloatArray,
    IntArray,
    Trajectory,
)

_MAX_NUMBER = 10**9  # chosen: a year at 30 Hz
_RATE_HZ = 30.0  # chosen: assumed rate of images that have numbers, but no stamps
_SUFFIXES = ('.jpg', '.jpeg', '.png', '.depth')
_MAX_BYTES = 100_000_000  # chosen: a trajectory of a million poses
# Chosen: largest size of color images as a multiple of the size of depth: 768x576 for the 256x192
# px of a phone's depth. A larger size costs more than it brings.
_MAX_REPEATS = 3
# Chosen: largest error of an element of R R^T, as rounding to float32 or text gives.
_MAX_SKEW = 1e-3


class ListedImage(NamedTuple):
    """One color or depth image."""

    stamp_ns: int
    path: Path  # the file that contains it
    read: Callable[[], ImageData] | None = None  # None: the file is the image

    def load(self) -> ImageData:
        """Return the image as it is stored, or as an array; InputError if it is unusable."""
        return self.read() if self.read is not None else read_image_bytes(self.path)


Images = tuple[ListedImage, ...]


class FolderCamera(NamedTuple):
    """The camera of a recording, as the files of its folder state it."""

    camera: CameraModel | None
    units_per_m: float = 0.0  # depth units per meter; 0: those of the layout


def listed_images(folder: Path, name: str) -> Images:
    """Return the images of a text file with a stamp (s) and a file in each line."""
    path = folder / name
    rows = sorted_rows(path)
    if not rows:
        raise InputError(f'{path}: lists no images')
    for row in rows:
        check_path_name(str(folder / row.text), f'{path}: line {row.line}')
        if not row.text or not (folder / row.text).is_file():
            raise InputError(f'{path}: line {row.line}: lists "{row.text}", which does not exist')
    return tuple(ListedImage(row.stamp_ns, folder / row.text) for row in rows)


def numbered_images(folder: Path, pattern: str) -> Images:
    """Return the images whose names end with a number, in order of that number."""
    numbers = {
        int(match[1]): path
        for path in folder.glob(pattern)
        if (match := re.search(r'(\d+)$', path.stem)) and path.suffix.lower() in _SUFFIXES
    }
    if not numbers:
        raise InputError(f'{folder}: has no images {pattern}')
    return tuple(ListedImage(numbered_stamp_ns(n), numbers[n]) for n in sorted(numbers))


def numbered_stamp_ns(number: int) -> int:
    """Return the stamp (ns) of a numbered image, at 30 Hz from 1 s on; InputError from 10^9 on."""
    if not 0 <= number < _MAX_NUMBER:
        raise InputError(f'{number} is no number of an image')
    return NS_PER_S + round(number * NS_PER_S / _RATE_HZ)


def resized_camera(camera: CameraModel, size_px: tuple[int, int]) -> CameraModel:
    """Return the camera of the same images at another size, which may stretch them."""
    x, y = size_px[0] / camera.width_px, size_px[1] / camera.height_px
    # The center of the first pixel is at 0, so that the image begins at -0.5.
    center_px = x * (camera.cx_px + 0.5) - 0.5, y * (camera.cy_px + 0.5) - 0.5
    return CameraModel(*size_px, x * camera.fx_px, y * camera.fy_px, *center_px)


def shrunk_camera(camera: CameraModel, depth_px: tuple[int, int]) -> CameraModel:
    """Return the camera of color images at a whole multiple of the size of depth.

    Phones record color at 7.5 times the size of depth, with the same view.
    """
    repeats = max(1, min(camera.width_px // depth_px[0], _MAX_REPEATS))
    return resized_camera(camera, (repeats * depth_px[0], repeats * depth_px[1]))


def resized_color(image: ListedImage, size_px: tuple[int, int]) -> ListedImage:
    """Return the color image, scaled to `size_px` (width, height) when it is read."""

    def read() -> ByteArray:
        pixels = decode_color(image.load(), image.path)
        if pixels.shape[1::-1] == size_px:
            return pixels
        return np.asarray(cv2.resize(pixels, size_px, interpolation=cv2.INTER_AREA), np.uint8)

    return image._replace(read=read)


def pinhole(path: Path, values: list[float]) -> CameraModel:
    """Return the camera with `values` width, height, fx, fy, cx, cy, which a file states."""
    width, height, fx, fy, cx, cy = values
    with prefixed(f'{path}: ', InputError, ConfigError, ValueError, OverflowError):
        return CameraModel(int(width), int(height), fx, fy, cx, cy)


def matrix_camera(path: Path, size_px: Sequence[float], K: FloatArray) -> CameraModel:
    """Return the camera with an image size and a matrix K (3, 3 or larger) from a file."""
    return pinhole(path, [*size_px, K[0, 0], K[1, 1], K[0, 2], K[1, 2]])


def read_json(path: Path) -> dict[str, Any]:
    """Return the object of a JSON file; InputError if it contains no object."""
    with replaced_by(InputError(f'{path}: is not JSON'), ValueError, RecursionError):
        found = json.loads(read_text(path))
    if not isinstance(found, dict):
        raise InputError(f'{path}: expected a JSON object')
    return found


def json_number(path: Path, found: Any, name: str) -> float:
    """Return a number of a JSON object; InputError if it has no number of this name."""
    value = found.get(name) if isinstance(found, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f'{path}: {name} must be a number, got {value!r}')
    with replaced_by(InputError(f'{path}: {name} is too large a number'), OverflowError):
        return float(value)


def json_table(path: Path, found: dict[str, Any], name: str, columns: int) -> FloatArray:
    """Return the numbers (N, columns) of a list in a JSON object; InputError if there is none."""
    problem = InputError(f'{path}: {name} must be rows of {columns} numbers')
    with replaced_by(problem, TypeError, ValueError, OverflowError):
        return np.array(found.get(name), np.float64).reshape(-1, columns)


def json_matrix(path: Path, found: dict[str, Any], name: str) -> FloatArray:
    """Return the matrix (3, 3) of nine numbers, column by column; else InputError."""
    problem = InputError(f'{path}: {name} must have nine numbers')
    with replaced_by(problem, TypeError, ValueError, OverflowError):
        return np.array(found.get(name), np.float64).reshape(3, 3).T


def read_table(
    path: Path, columns: int, *, separator: str | None = None, num_titles: int = 0
) -> FloatArray:
    """Return the numbers (N, columns) of a text file after its lines of titles."""
    lines = read_text(path, _MAX_BYTES).splitlines()
    with replaced_by(InputError(f'{path}: expected {columns} numbers in each line'), ValueError):
        rows: FloatArray = np.loadtxt(lines, delimiter=separator, skiprows=num_titles, ndmin=2)
        return rows[:, :columns].reshape(-1, columns)


def rigid_poses(stamps_ns: IntArray, T: FloatArray) -> Trajectory:
    """Return the rigid poses among N matrices (N, 4, 4); others mean that tracking was lost."""
    R = T[:, :3, :3]
    with np.errstate(invalid='ignore'):  # comparisons with NaN are false
        is_rotation = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max((1, 2)) < _MAX_SKEW
    is_rigid = is_rotation & np.isfinite(T).all((1, 2))
    return Trajectory(stamps_ns[is_rigid], se3.orthonormalized(T[is_rigid]))


def quaternion_poses(stamps_ns: IntArray, quat_xyzw: FloatArray, t_m: FloatArray) -> Trajectory:
    """Return the valid poses with quaternions xyzw (N, 4) and positions (N, 3) [m]."""
    with np.errstate(invalid='ignore'):  # quaternions of zeros
        return rigid_poses(stamps_ns, se3.from_quat_translation(quat_xyzw, t_m))
