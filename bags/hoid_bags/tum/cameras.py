"""Known cameras by name, and cameras from ROS `camera_info` YAML files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hoid_common.errors import ConfigError, InputError, prefixed
from hoid_common.io.yaml_file import read_yaml
from hoid_common.values import DISTORTION_MODELS, EQUIDISTANT, CameraModel

CAMERA_FILE = 'camera.yaml'
"""Name of the file of the camera in a TUM folder, as `camera_calibration` writes it."""
TUM_DEPTH_UNITS_PER_M = 5000.0
"""Depth units per meter of the PNG files of all three cameras, as the benchmark's authors state.

ORB-SLAM divides freiburg 2 by 5208, but the published files already contain that correction.
"""

_FR1 = CameraModel(
    640, 480, 517.306408, 516.469215, 318.643040, 255.313989,
    (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
)  # fmt: skip
_FR2 = CameraModel(
    640, 480, 520.908620, 521.007327, 325.141442, 249.701764,
    (0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
)  # fmt: skip
_FR3 = CameraModel(640, 480, 535.4, 539.2, 320.1, 247.6)
_BONN = CameraModel(
    640, 480, 542.822841, 542.576870, 315.593520, 237.756098,
    (0.039903, -0.099343, -0.000730, -0.000144, 0.0),
)  # fmt: skip
TUM_CAMERAS = {'fr1': _FR1, 'fr2': _FR2, 'fr3': _FR3, 'bonn': _BONN}
"""Published intrinsics of the color cameras of TUM RGB-D and of Bonn RGB-D Dynamic."""

_TUM_NAME = re.compile(r'(?<![a-z])(?:freiburg|fr)[ _-]?([123])(?![0-9])', re.IGNORECASE)
_BONN_NAME = re.compile(r'(?<![a-z])bonn(?![a-z])', re.IGNORECASE)


def camera_from_name(name: str) -> CameraModel | None:
    """Return the published camera that a folder name mentions, such as fr1 or bonn, or None."""
    if _BONN_NAME.search(name):
        return _BONN
    match = _TUM_NAME.search(name)
    return TUM_CAMERAS[f'fr{match.group(1)}'] if match else None


def find_camera(requested: str) -> CameraModel:
    """Return the camera of fr1, fr2, fr3, bonn or a YAML file; InputError for any other."""
    known = TUM_CAMERAS.get(requested.lower())
    if known is not None:
        return known
    path = Path(requested)
    if not path.exists():
        raise InputError(
            f'camera "{requested}": neither {", ".join(TUM_CAMERAS)} nor a file; check the path'
        )
    return read_camera_yaml(path)


def read_camera_yaml(path: Path) -> CameraModel:
    """Return the camera in a YAML file of `camera_calibration` or `camera_info_manager`."""
    loaded = read_yaml(path)
    if not isinstance(loaded, dict):
        raise InputError(
            f'{path}: expected a camera_info mapping with image_width and camera_matrix'
        )
    k = _numbers(path, loaded, 'camera_matrix', count=9)
    model = loaded.get('distortion_model', 'plumb_bob')
    if model not in DISTORTION_MODELS:
        raise InputError(
            f'{path}: distortion_model "{model}" is not one of {", ".join(DISTORTION_MODELS)}'
        )
    distortion: tuple[float, ...] = ()
    if 'distortion_coefficients' in loaded:
        distortion = _numbers(path, loaded, 'distortion_coefficients')
    size = [_positive_int(path, loaded, key) for key in ('image_width', 'image_height')]
    with prefixed(f'{path}: ', InputError, ConfigError):
        return CameraModel(
            size[0], size[1], k[0], k[4], k[2], k[5], distortion, model == EQUIDISTANT
        )


def _positive_int(path: Path, loaded: dict[str, Any], key: str) -> int:
    value = loaded.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or value <= 0:
        raise InputError(f'{path}: {key} must be a positive whole number, got {value!r}')
    return value


def _numbers(
    path: Path, loaded: dict[str, Any], key: str, count: int | None = None
) -> tuple[float, ...]:
    matrix = loaded.get(key)
    data = matrix.get('data') if isinstance(matrix, dict) else None
    if not isinstance(data, list) or not all(type(x) in (int, float) for x in data):
        raise InputError(f'{path}: {key}.data is missing or not a list of numbers')
    if count is not None and len(data) != count:
        raise InputError(f'{path}: {key}.data has {len(data)} numbers, expected {count}')
    return tuple(float(x) for x in data)
