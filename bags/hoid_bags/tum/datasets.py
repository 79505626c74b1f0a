"""Cameras, poses and images of published data sets, by the files that describe them."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from hoid_bags.images import read_image_bytes
from hoid_bags.tum import listing
from hoid_bags.tum.cameras import CAMERA_FILE, camera_from_name, read_camera_yaml
from hoid_bags.tum.listing import FolderCamera, Images, ListedImage
from hoid_common.errors import ConfigError, InputError, replaced_by
from hoid_common.io.image_size import image_size_px
from hoid_common.io.tum_text import read_tum
from hoid_common.io.untrusted import read_text
from hoid_common.values import (
    NS_PER_S,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
    Trajectory,
)

# ICL-NUIM states fy = -480, because y of its cameras points up.
_ICL = CameraModel(640, 480, 481.20, 480.0, 319.5, 239.5)
_Y_UP = np.diag([1.0, -1.0, 1.0, 1.0])
_NUMBER = re.compile(r'[0-9]{1,30}')  # more digits than any number of an image has
_ICL_VECTOR = re.compile(r'cam_(right|up|dir|pos)\s*=\s*\[([^\]]*)\]')


def listed(folder: Path, color: str, depth: str) -> tuple[Images, Images]:
    return listing.listed_images(folder, color), listing.listed_images(folder, depth)


def numbered(folder: Path, color: str, depth: str) -> tuple[Images, Images]:
    return listing.numbered_images(folder, color), listing.numbered_images(folder, depth)


def tum_camera(folder: Path) -> FolderCamera:
    """Return the camera of camera.yaml, else the published one that the folder is named after."""
    path = folder / CAMERA_FILE
    if path.is_file():
        return FolderCamera(read_camera_yaml(path))
    return FolderCamera(camera_from_name(folder.resolve().name))


def eth3d_camera(folder: Path) -> FolderCamera:
    """Return the camera of calibration.txt (fx fy cx cy), with the size of the first image."""
    path = folder / 'calibration.txt'
    fields = read_text(path).split()
    first = min((folder / 'rgb').glob('*.png'), default=None)
    size_px = image_size_px(read_image_bytes(first)) if first is not None else None
    problem = InputError(f'{path}: expected fx fy cx cy of the images in rgb/')
    with replaced_by(problem, ValueError, ConfigError):
        fx, fy, cx, cy = map(float, fields)
        return FolderCamera(CameraModel(*(size_px or (0, 0)), fx, fy, cx, cy))


def openloris_camera(folder: Path) -> FolderCamera:
    """Return the color camera of sensors.yaml, whose matrix of one row is fx, cx, fy, cy."""
    path = folder / 'sensors.yaml'
    if not path.exists():
        return FolderCamera(None)
    storage = _opencv_yaml(path)  # its nodes do not keep it alive
    problem = InputError(f'{path}: has no intrinsics of d400_color_optical_frame')
    with replaced_by(problem, AttributeError, ValueError, cv2.error):
        camera = storage.getNode('d400_color_optical_frame')
        fx, cx, fy, cy = map(float, camera.getNode('intrinsics').mat().ravel())
        size = [camera.getNode(name).real() for name in ('width', 'height')]
    return FolderCamera(listing.pinhole(path, [*size, fx, fy, cx, cy]))


def openloris_truth(path: Path) -> Trajectory:
    """Return the poses of the color camera, from the poses of the robot's base in the file."""
    truth, transforms = read_tum(path), path.parent / 'trans_matrix.yaml'
    storage = _opencv_yaml(transforms)
    with suppress(cv2.error):  # a node is of another type
        edges = storage.getNode('trans_matrix')
        for edge in (edges.at(i) for i in range(edges.size())):
            names = [edge.getNode(name).string() for name in ('parent_frame', 'child_frame')]
            T_base_color = np.asarray(edge.getNode('matrix').mat(), float)  # NaN if there is none
            is_wanted = names == ['base_link', 'd400_color_optical_frame']
            if is_wanted and T_base_color.shape == (4, 4):
                return listing.rigid_poses(truth.stamps_ns, truth.T_world_camera @ T_base_color)
    raise InputError(f'{transforms}: has no d400_color_optical_frame on base_link')


def _opencv_yaml(path: Path) -> cv2.FileStorage:
    """Return a YAML file of OpenCV, whose tags other parsers do not know."""
    flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
    with replaced_by(InputError(f'{path}: is no YAML file of OpenCV'), cv2.error, SystemError):
        return cv2.FileStorage(read_text(path), flags)


def replica_camera(folder: Path) -> FolderCamera:
    """Return the camera of NICE-SLAM's cam_params.json, in the folder or beside it."""
    for path in (folder / 'cam_params.json', folder.parent / 'cam_params.json'):
        if path.exists():
            found = listing.read_json(path).get('camera')
            names = ('w', 'h', 'fx', 'fy', 'cx', 'cy')
            values = [listing.json_number(path, found, name) for name in names]
            units_per_m = listing.json_number(path, found, 'scale')
            return FolderCamera(listing.pinhole(path, values), units_per_m)
    return FolderCamera(None)


def replica_truth(path: Path) -> Trajectory:
    """Return the poses of a file with a 4x4 matrix T_world_camera in each line, row by row."""
    T = listing.read_table(path, 16).reshape(-1, 4, 4)
    return Trajectory(_numbered_stamps(range(len(T))), T)


def open3d_camera(folder: Path) -> FolderCamera:
    """Return the camera of Open3D's intrinsic.json: its matrix is stored column by column."""
    names = ('intrinsic.json', 'camera_intrinsic.json')
    path = next(path for name in names if (path := folder / name).exists())
    found = listing.read_json(path)
    K = listing.json_matrix(path, found, 'intrinsic_matrix')
    size_px = [listing.json_number(path, found, name) for name in ('width', 'height')]
    units_per_m = (
        listing.json_number(path, found, 'depth_scale') if 'depth_scale' in found else 0.0
    )
    return FolderCamera(listing.matrix_camera(path, size_px, K), units_per_m)


def icl_camera(_folder: Path) -> FolderCamera:
    return FolderCamera(_ICL)


def icl_images(folder: Path, associations: str, _depth: str) -> tuple[Images, Images]:
    """Return the images of a list with number and file of depth, then of color, in each line."""
    path = folder / associations
    colors: list[ListedImage] = []
    depths: list[ListedImage] = []
    for line in read_text(path).splitlines():
        words = line.split()
        for number, name in zip(words[::2], words[1::2], strict=False):
            if not _NUMBER.fullmatch(number) or not (folder / name).is_file():
                raise InputError(f'{path}: "{line}": expected a number and a file, twice')
            image = ListedImage(listing.numbered_stamp_ns(int(number)), folder / name)
            (depths if name.startswith('depth') else colors).append(image)
    return tuple(colors), tuple(depths)


def icl_truth(path: Path) -> Trajectory:
    """Return the poses of a `.gt.freiburg` file, whose stamps are image numbers."""
    truth = read_tum(path)
    return _without_y_up((truth.stamps_ns // NS_PER_S).tolist(), truth.T_world_camera)


def icl_scene(folder: Path, color: str, depth: str) -> tuple[Images, Images]:
    """Return the images that POV-Ray rendered, with depth from text files of distances."""
    colors, depths = numbered(folder, color, depth)
    return colors, tuple(d._replace(read=partial(_icl_depth_m, d.path)) for d in depths)


def _icl_depth_m(path: Path) -> Float32Array:
    """Return the (H, W) depth in m of a text file of distances from the camera's center."""
    words = read_text(path).split()
    u, v = np.meshgrid(np.arange(_ICL.width_px), np.arange(_ICL.height_px))
    rays = (u - _ICL.cx_px) / _ICL.fx_px, (v - _ICL.cy_px) / _ICL.fy_px, np.ones(u.shape)
    problem = InputError(f'{path}: expected {u.size} distances, got {len(words)} words')
    with replaced_by(problem, ValueError):
        distance_m = np.array(words, np.float32).reshape(_ICL.size_px[::-1])
    return np.asarray(distance_m / np.linalg.norm(rays, axis=0), np.float32)


def icl_scene_truth(first: Path) -> Trajectory:
    """Return the poses of POV-Ray's text files, one for each image."""
    paths = {
        int(digits): path
        for path in first.parent.glob('scene_*.txt')
        if _NUMBER.fullmatch(digits := path.stem.rpartition('_')[2])
    }
    poses = []
    for number in sorted(paths):
        found = dict(_ICL_VECTOR.findall(read_text(paths[number])))
        with replaced_by(InputError(f'{paths[number]}: has no pose'), KeyError, ValueError):
            names = ('right', 'up', 'dir', 'pos')
            rows = np.array([np.array(found[name].split(','), float) for name in names])
        T = np.eye(4)
        with np.errstate(invalid='ignore'):  # vectors of zeros
            axes = rows[:3] / np.linalg.norm(rows[:3], axis=1, keepdims=True)
        T[:3] = np.vstack([axes, rows[3]]).T
        poses.append(T)
    return _without_y_up(sorted(paths), np.array(poses).reshape(-1, 4, 4))


def _without_y_up(numbers: list[int], T: FloatArray) -> Trajectory:
    """Return poses (N, 4, 4) of cameras and a world whose y points up, with y down in both."""
    return listing.rigid_poses(_numbered_stamps(numbers), _Y_UP @ T @ _Y_UP)


def _numbered_stamps(numbers: list[int] | range) -> IntArray:
    return np.array([listing.numbered_stamp_ns(number) for number in numbers], np.int64)
