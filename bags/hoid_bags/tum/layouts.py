"""Layouts of folders with RGB-D images, one row each; `tum_folder` reads all of them.

The layouts are those of their own documentation: TUM RGB-D and Bonn, ETH3D SLAM, OpenLORIS-Scene,
Replica as NICE-SLAM renders it, and Open3D's recorders for RealSense and Azure Kinect.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoid_bags.images import read_image_bytes
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, camera_from_name
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.image_size import image_size_px
from hoid_common.io.trajectory_io import read_tum
from hoid_common.io.untrusted import read_text
from hoid_common.values import NS_PER_S, CameraModel, FloatArray, IntArray, Trajectory

COLOR_LIST = 'rgb.txt'
DEPTH_LIST = 'depth.txt'
GROUND_TRUTH = 'groundtruth.txt'
ACCELEROMETER = 'accelerometer.txt'
GYRO = 'gyro.txt'
_MM = 1000.0
_RATE_HZ = 30.0  # chosen: of recordings whose files have numbers and no stamps
_OPENLORIS_COLOR = re.compile(
    r'd400_color_optical_frame:.*?width:\s*(?P<w>\d+).*?height:\s*(?P<h>\d+)'
    r'.*?data:\s*\[(?P<data>[^]]+)\]',
    re.DOTALL,
)
_MAX_BYTES = 100_000_000  # chosen: a trajectory of a million poses


class FolderCamera(NamedTuple):
    """What the files of a folder say of the camera."""

    camera: CameraModel | None
    units_per_m: float = 0.0  # depth units per meter; 0: those of the layout


class Layout(NamedTuple):
    """Names of the files of a recording, relative to its folder."""

    name: str
    marks: tuple[str, ...]  # names that exist, or names separated by `|` of which one exists
    color: str  # list of stamps and files, or pattern of numbered files
    depth: str
    units_per_m: float
    read_camera: Callable[[Path], FolderCamera]
    truth: str = GROUND_TRUTH  # '' = there is none, or it belongs to another frame
    read_truth: Callable[[Path], Trajectory] = read_tum
    gyro: str = GYRO
    accelerometer: str = ACCELEROMETER

    @property
    def is_numbered(self) -> bool:
        """Return whether the files have numbers and no stamps."""
        return '*' in self.color


def numbered_stamp_ns(number: int) -> int:
    """Return the stamp (ns) of a numbered image, at 30 Hz from 1 s on."""
    return NS_PER_S + round(number * NS_PER_S / _RATE_HZ)


def find_layout(folder: Path) -> Layout | None:
    """Return the layout of a folder by the names of its files; None if it has no known layout."""
    for layout in LAYOUTS:
        if all(any((folder / n).exists() for n in mark.split('|')) for mark in layout.marks):
            return layout
    return None


def _camera_in_name(folder: Path) -> FolderCamera:
    return FolderCamera(camera_from_name(folder.resolve().name))


def _eth3d_camera(folder: Path) -> FolderCamera:
    """Return the camera of calibration.txt (fx fy cx cy), with the size of the first image."""
    path = folder / 'calibration.txt'
    fields = read_text(path).split()
    first = min((folder / 'rgb').glob('*.png'), default=None)
    size_px = image_size_px(read_image_bytes(first)) if first is not None else None
    try:
        fx, fy, cx, cy = map(float, fields)
        return FolderCamera(CameraModel(*(size_px or (0, 0)), fx, fy, cx, cy))
    except (ValueError, ConfigError) as error:
        raise InputError(f'{path}: expected fx fy cx cy of the images in rgb/') from error


def _openloris_camera(folder: Path) -> FolderCamera:
    """Return the color camera of sensors.yaml, which has tags of OpenCV and is no plain YAML.

    Its matrix of one row is fx, cx, fy, cy.
    """
    path = folder / 'sensors.yaml'
    if not path.exists():
        return FolderCamera(None)
    found = _OPENLORIS_COLOR.search(read_text(path))
    values = re.split(r'[\s,]+', found['data'].strip()) if found else []
    try:
        fx, cx, fy, cy = map(float, values)
    except ValueError as error:
        raise InputError(f'{path}: has no intrinsics of d400_color_optical_frame') from error
    assert found is not None
    return FolderCamera(_camera(path, [int(found['w']), int(found['h']), fx, fy, cx, cy]))


def _replica_camera(folder: Path) -> FolderCamera:
    """Return the camera of NICE-SLAM's cam_params.json, in the folder or beside it."""
    for path in (folder / 'cam_params.json', folder.parent / 'cam_params.json'):
        if path.exists():
            found = _json(path).get('camera')
            names = ('w', 'h', 'fx', 'fy', 'cx', 'cy')
            return FolderCamera(
                _camera(path, [_number(path, found, n) for n in names]),
                _number(path, found, 'scale'),
            )
    return FolderCamera(None)


def _open3d_camera(folder: Path) -> FolderCamera:
    """Return the camera of Open3D's intrinsic.json: its matrix is stored column by column."""
    paths = (folder / name for name in _OPEN3D_CAMERA.split('|'))
    path = next(path for path in paths if path.exists())
    found = _json(path)
    matrix = found.get('intrinsic_matrix')
    if not isinstance(matrix, list) or len(matrix) != 9:
        raise InputError(f'{path}: intrinsic_matrix must have nine numbers')
    k = {str(i): value for i, value in enumerate(matrix)}
    size = [_number(path, found, name) for name in ('width', 'height')]
    camera = _camera(path, size + [_number(path, k, i) for i in ('0', '4', '6', '7')])
    units = _number(path, found, 'depth_scale') if 'depth_scale' in found else 0.0
    return FolderCamera(camera, units)


def _camera(path: Path, values: list[float]) -> CameraModel:
    width, height, fx, fy, cx, cy = values
    try:
        return CameraModel(int(width), int(height), fx, fy, cx, cy)
    except ConfigError as error:
        raise InputError(f'{path}: {error}') from error


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f'{path}: is not JSON') from error
    if not isinstance(found, dict):
        raise InputError(f'{path}: expected a JSON object')
    return found


def _number(path: Path, found: Any, name: str) -> float:
    value = found.get(name) if isinstance(found, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f'{path}: {name} must be a number, got {value!r}')
    return float(value)


def _matrices(path: Path) -> Trajectory:
    """Return the poses of a file with a 4x4 matrix T_world_camera in each line, row by row."""
    try:
        rows: FloatArray = np.loadtxt(read_text(path, _MAX_BYTES).splitlines(), ndmin=2)
        T = rows.reshape(-1, 4, 4)
    except ValueError as error:
        raise InputError(f'{path}: expected 16 numbers in each line') from error
    stamps: IntArray = np.array([numbered_stamp_ns(i) for i in range(len(T))], np.int64)
    return Trajectory(stamps, T)


_OPEN3D_CAMERA = 'intrinsic.json|camera_intrinsic.json'
TUM = Layout('TUM', (COLOR_LIST,), COLOR_LIST, DEPTH_LIST, TUM_DEPTH_UNITS_PER_M, _camera_in_name)
LAYOUTS = (
    Layout(
        'ETH3D', (COLOR_LIST, 'calibration.txt'), COLOR_LIST, DEPTH_LIST, TUM_DEPTH_UNITS_PER_M,
        _eth3d_camera,
    ),
    TUM,
    # Its poses are those of the robot.
    Layout(
        'OpenLORIS', ('color.txt', 'aligned_depth.txt'), 'color.txt', 'aligned_depth.txt', _MM,
        _openloris_camera, truth='', gyro='d400_gyroscope.txt',
        accelerometer='d400_accelerometer.txt',
    ),
    Layout(
        'Replica', ('traj.txt', 'results'), 'results/frame*', 'results/depth*', 6553.5,
        _replica_camera, truth='traj.txt', read_truth=_matrices,
    ),
    Layout(
        'Open3D', ('color', 'depth', _OPEN3D_CAMERA), 'color/*', 'depth/*', _MM, _open3d_camera,
        truth='',
    ),
)  # fmt: skip
"""The known layouts; the first whose marks exist is taken."""
