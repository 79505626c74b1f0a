"""Layouts of RGB-D recordings in files, one row each; `tum_folder` reads all of them.

Each follows its own documentation: TUM RGB-D and Bonn, ETH3D SLAM, OpenLORIS-Scene, Replica as
NICE-SLAM renders it, ICL-NUIM, ScanNet, Open3D's recorders for RealSense and Azure Kinect, and the
apps Record3D and Stray Scanner for iPhones.
"""

from __future__ import annotations

from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple, NoReturn

from hoid_bags.tum import datasets, phones, sens
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M
from hoid_bags.tum.listing import FolderCamera, Images
from hoid_common.errors import InputError
from hoid_common.io.tum_text import NumberTable, read_numbers, read_tum
from hoid_common.values import Trajectory

COLOR_LIST = 'rgb.txt'
DEPTH_LIST = 'depth.txt'
GROUND_TRUTH = 'groundtruth.txt'
ACCELEROMETER = 'accelerometer.txt'
GYRO = 'gyro.txt'
_MM, _M = 1000.0, 1.0
_ASSUMED_30_HZ = 'stamps of an assumed 30 Hz'
_SHRUNK = 'color scaled to a multiple of the size of depth'


class Layout(NamedTuple):
    """How the files of a recording are named, relative to its folder, and read."""

    name: str
    marks: tuple[str, ...]  # patterns of files that exist; `|` separates alternatives
    color: str  # list of stamps and files, or pattern of files
    depth: str
    units_per_m: float
    read_camera: Callable[[Path], FolderCamera]
    # Returns color and depth images of the folder by `color` and `depth`.
    read_images: Callable[[Path, str, str], tuple[Images, Images]] = datasets.listed
    truth: str = GROUND_TRUTH  # pattern; '' = there is none
    read_truth: Callable[[Path], Trajectory] = read_tum
    gyro: str = GYRO
    accelerometer: str = ACCELEROMETER
    # Returns rates and accelerations; None: `gyro` and `accelerometer` are text files of them.
    read_imu: Callable[[Path], tuple[NumberTable | None, NumberTable | None]] | None = None
    note: str = ''

    def truth_path(self, path: Path) -> Path | None:
        """Return the file of the ground truth in a folder; None if there is none."""
        if path.is_file():
            return path
        return min(path.glob(self.truth), default=None) if self.truth else None

    def imu(self, path: Path) -> tuple[NumberTable | None, NumberTable | None]:
        """Return rates (N, 3) [rad/s] and accelerations (N, 3) [m/s^2], each None if missing."""
        if self.read_imu is not None:
            return self.read_imu(path)
        gyro, accelerometer = (
            read_numbers(file, columns=3) if file.is_file() else None
            for file in (path / self.gyro, path / self.accelerometer)
        )
        return gyro, accelerometer


def find_layout(path: Path) -> Layout | None:
    """Return the layout of a folder or file by the names of files; None if it is not known."""
    for layout in LAYOUTS:
        if all(any(has_file(path, n) for n in mark.split('|')) for mark in layout.marks):
            return layout
    return None


def has_file(path: Path, pattern: str) -> bool:
    """Return whether a path matches a glob pattern: a file itself, or a file in a folder."""
    return any(path.glob(pattern)) if path.is_dir() else fnmatch(path.name, pattern)


def _refuse_r3d(path: Path, *_: str) -> NoReturn:
    raise InputError(
        f'{path}: depth of .r3d is packed with LZFSE; export the recording as "EXR + RGB" instead'
    )


TUM = Layout(
    'TUM', (COLOR_LIST,), COLOR_LIST, DEPTH_LIST, TUM_DEPTH_UNITS_PER_M, datasets.tum_camera
)
LAYOUTS = (
    Layout(
        'ETH3D', (COLOR_LIST, 'calibration.txt'), COLOR_LIST, DEPTH_LIST, TUM_DEPTH_UNITS_PER_M,
        datasets.eth3d_camera,
    ),
    TUM,
    Layout(
        'OpenLORIS', ('color.txt', 'aligned_depth.txt'), 'color.txt', 'aligned_depth.txt', _MM,
        datasets.openloris_camera, read_truth=datasets.openloris_truth,
        gyro='d400_gyroscope.txt', accelerometer='d400_accelerometer.txt',
    ),
    Layout(
        'ICL-NUIM', ('associations.txt', 'rgb/0.png|rgb/1.png'), 'associations.txt',
        'associations.txt', TUM_DEPTH_UNITS_PER_M, datasets.icl_camera, datasets.icl_images,
        '*.gt.freiburg', datasets.icl_truth, note=_ASSUMED_30_HZ,
    ),
    Layout(
        'ICL-NUIM of POV-Ray', ('scene_*.depth', 'scene_*.png'), 'scene_*.png', 'scene_*.depth',
        _M, datasets.icl_camera, datasets.icl_scene, 'scene_*.txt', datasets.icl_scene_truth,
        note=_ASSUMED_30_HZ,
    ),
    Layout(
        'Replica', ('traj.txt', 'results'), 'results/frame*', 'results/depth*', 6553.5,
        datasets.replica_camera, datasets.numbered, 'traj.txt', datasets.replica_truth,
        note=_ASSUMED_30_HZ,
    ),
    Layout(
        'Open3D', ('color', 'depth', 'intrinsic.json|camera_intrinsic.json'), 'color/*',
        'depth/*', _MM, datasets.open3d_camera, datasets.numbered, '', note=_ASSUMED_30_HZ,
    ),
    Layout(
        'Record3D', ('metadata.json', 'depth/0.exr'), 'rgb/*', 'depth/*.exr', _M,
        phones.record3d_camera, phones.record3d_images, 'metadata.json', phones.record3d_truth,
        note=_SHRUNK,
    ),
    Layout('Record3D', ('*.r3d|rgbd/0.depth',), '', '', _M, _refuse_r3d, _refuse_r3d),
    Layout(
        'Stray Scanner', ('odometry.csv', 'camera_matrix.csv', 'rgb.mp4'), 'rgb.mp4',
        'depth/*.png', _MM, phones.stray_camera, phones.stray_images, 'odometry.csv',
        phones.stray_truth, 'imu.csv', '', phones.stray_imu, _SHRUNK,
    ),
    Layout(
        'ScanNet', (f'*{sens.SUFFIX}',), f'*{sens.SUFFIX}', f'*{sens.SUFFIX}', _M,
        sens.sens_camera, sens.sens_images, f'*{sens.SUFFIX}', sens.sens_truth, f'*{sens.SUFFIX}',
        '', sens.sens_imu, f'{_SHRUNK}, to which it is mapped',
    ),
)  # fmt: skip
"""The known layouts, in order: the first one whose marks exist is used."""
