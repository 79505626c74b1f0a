"""The mounting of an IMU: its rotation to the camera, estimated, given, or read from a file."""

from __future__ import annotations

from itertools import permutations, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.io.untrusted import expand_home
from hoid_common.io.yaml_file import read_yaml
from hoid_common.values import FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.rotations import rotation_vector

# Chosen: an estimated rotation is replaced by the nearest one of the 24 rotations between parallel
# axes if it differs by less than this angle plus three standard deviations. IMUs are soldered
# parallel to the camera, and the 24 rotations differ by 90 degrees.
_AXES_RAD, _NUM_SIGMAS = np.deg2rad(3.0), 3.0
# Not tuned: largest error of a rotation matrix in a file, which has 8 digits.
_MAX_ROTATION_ERROR = 1e-3
_CAMERA = 'cam0'
_MAX_TIMESHIFT_S = 3600.0  # chosen: no two clocks of one computer are an hour apart
# Chosen: standard deviations about each axis of a mounting that TF states or that is parallel to
# the axes, and of one that was calibrated. Parts are mounted to about a degree, and the axes of an
# accelerometer are orthogonal to 1 %.
PARALLEL_SIGMA_RAD, _CALIBRATED_SIGMA_RAD = np.deg2rad(1.0), np.deg2rad(0.3)


class Mounting(NamedTuple):
    """The mounting of an IMU, as TF or a calibration file states it."""

    R_camera_imu: FloatArray  # (3, 3)
    offset_s: float = 0.0  # the stamps of the IMU are later than those of the images by this time
    sigma_rad: float = PARALLEL_SIGMA_RAD  # standard deviation of the rotation about each axis


def snapped(R_camera_imu: FloatArray, sigma_rad: float) -> FloatArray:
    """Return the nearest rotation of parallel axes if it is close, else R_camera_imu itself."""
    nearest = _PARALLEL[np.argmax(np.einsum('nij,ij->n', _PARALLEL, R_camera_imu))]
    angle_rad = float(np.linalg.norm(rotation_vector(nearest.T @ R_camera_imu)))
    return nearest if angle_rad < _AXES_RAD + _NUM_SIGMAS * sigma_rad else R_camera_imu


def kalibr_mounting(config: ImuConfig) -> Mounting | None:
    """Return the mounting in the Kalibr file `imu.calibration`, or None if none is set."""
    if not config.calibration:
        return None
    return read_kalibr(expand_home(config.calibration, 'imu.calibration'))


def read_kalibr(path: Path) -> Mounting:
    """Return the mounting from the file `camchain-imucam.yaml` that Kalibr writes.

    Raises:
        InputError: The file cannot be read, `T_cam_imu` is missing or has no rotation, or
            `timeshift_cam_imu` is no number below an hour.
    """
    content = read_yaml(path)
    entry = content.get(_CAMERA) if isinstance(content, dict) else None
    if not isinstance(entry, dict):
        raise InputError(f'{path}: expected the entry {_CAMERA}, as Kalibr writes it')
    T = _matrix(entry.get('T_cam_imu'))
    if T is None:
        raise InputError(f'{path}: {_CAMERA}.T_cam_imu is missing or not 4 x 4 numbers')
    R = se3.orthonormalized(T)[:3, :3]
    if not np.allclose(R, T[:3, :3], atol=_MAX_ROTATION_ERROR):
        raise InputError(f'{path}: {_CAMERA}.T_cam_imu is no rotation')
    offset_s = entry.get('timeshift_cam_imu', 0.0)
    if not isinstance(offset_s, int | float) or not abs(offset_s) < _MAX_TIMESHIFT_S:
        raise InputError(f'{path}: {_CAMERA}.timeshift_cam_imu is not a time in seconds')
    return Mounting(R, float(offset_s), _CALIBRATED_SIGMA_RAD)


def _matrix(rows: Any) -> FloatArray | None:
    try:
        T = np.array(rows, np.float64)
    except (TypeError, ValueError):
        return None
    return T if T.shape == (4, 4) and np.isfinite(T).all() else None


def _parallel_axes() -> FloatArray:
    """Return the 24 rotations (24, 3, 3) between frames with parallel axes."""
    matrices = (
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    )
    return np.stack([matrix for matrix in matrices if np.linalg.det(matrix) > 0])


_PARALLEL = _parallel_axes()
