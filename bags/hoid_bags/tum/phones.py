"""Recordings of iPhones: Record3D's EXR export and Stray Scanner.

Formats: https://record3d.app and https://github.com/strayrobots/scanner/blob/main/docs/format.md.
"""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path

import numpy as np

from hoid_bags.images import ImageData, decode_color, decode_depth, read_image_bytes
from hoid_bags.storage.video import VideoFile
from hoid_bags.tum import listing
from hoid_bags.tum.exr import decode_exr
from hoid_bags.tum.listing import FolderCamera, Images, ListedImage
from hoid_common.errors import InputError
from hoid_common.io.image_size import image_size_px
from hoid_common.io.stamps import END_STAMP_NS, in_order
from hoid_common.io.tum_text import NumberTable
from hoid_common.values import NS_PER_S, Float32Array, FloatArray, IntArray, Trajectory

_LOG = logging.getLogger(__name__)
# ARKit's cameras have y up and z backward.
_T_ARKIT_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
_G_MPS2 = 9.80665  # unit of Core Motion's accelerations, which point down at rest
_GRAVITY_G = 0.5, 2.0  # chosen: range of the length of a median acceleration that contains gravity
_STRAY_POSE_COLUMNS, _STRAY_IMU_COLUMNS = 9, 7


def record3d_camera(folder: Path) -> FolderCamera:
    """Return the camera in metadata.json, for color scaled to a multiple of the depth size."""
    path = folder / 'metadata.json'
    found = listing.read_json(path)
    size_px = [listing.json_number(path, found, name) for name in ('w', 'h')]
    camera = listing.matrix_camera(path, size_px, listing.json_matrix(path, found, 'K'))
    first = folder / 'depth' / '0.exr'
    height, width = _exr_m(first).shape
    return FolderCamera(listing.shrunk_camera(camera, (width, height)))


def record3d_images(folder: Path, _color: str, _depth: str) -> tuple[Images, Images]:
    camera, (stamps_ns, _) = record3d_camera(folder).camera, _record3d_poses(folder)
    assert camera is not None
    colors, depths = [], []
    for i, stamp_ns in enumerate(stamps_ns.tolist()):
        paths = [folder / 'rgb' / f'{i}.{ending}' for ending in ('jpg', 'png')]
        color = next(filter(Path.is_file, paths), None)
        depth = folder / 'depth' / f'{i}.exr'
        if color is None or not depth.is_file():
            raise InputError(f'{folder}: lacks image {i} of metadata.json')
        colors.append(listing.resized_color(ListedImage(stamp_ns, color), camera.size_px))
        depths.append(ListedImage(stamp_ns, depth, partial(_exr_m, depth)))
    return tuple(colors), tuple(depths)


def record3d_truth(path: Path) -> Trajectory:
    stamps_ns, rows = _record3d_poses(path.parent)
    truth = listing.quaternion_poses(stamps_ns, rows[:, :4], rows[:, 4:])
    return Trajectory(truth.stamps_ns, truth.T_world_camera @ _T_ARKIT_CAMERA)


def _exr_m(path: Path) -> Float32Array:
    return decode_exr(read_image_bytes(path), path)


def _record3d_poses(folder: Path) -> tuple[IntArray, FloatArray]:
    """Return the stamps (N,) [ns] and the poses of metadata.json, (N, 7) qx qy qz qw tx ty tz.

    A recording without stamps gets stamps from 1 s on, at its frame rate.
    """
    path = folder / 'metadata.json'
    found = listing.read_json(path)
    rows = listing.json_table(path, found, 'poses', 7)
    if 'frameTimestamps' in found:
        stamps_s = listing.json_table(path, found, 'frameTimestamps', 1).ravel()
    else:
        stamps_s = 1 + np.arange(len(rows)) / listing.json_number(path, found, 'fps')
    if len(stamps_s) != len(rows):
        raise InputError(f'{path}: {len(rows)} poses, but {len(stamps_s)} stamps')
    return _stamps_ns(path, stamps_s), rows


def stray_camera(folder: Path) -> FolderCamera:
    """Return the camera of camera_matrix.csv for color at a multiple of depth."""
    path = folder / 'camera_matrix.csv'
    K = listing.read_table(path, 3, separator=',')
    if K.shape != (3, 3):
        raise InputError(f'{path}: expected three lines of three numbers')
    camera = listing.matrix_camera(path, VideoFile(folder / 'rgb.mp4').size_px, K)
    first = min((folder / 'depth').glob('*.png'), default=folder / 'depth')
    depth_px = image_size_px(read_image_bytes(first))
    if depth_px is None or 0 in depth_px:
        raise InputError(f'{first}: is no PNG')
    return FolderCamera(listing.shrunk_camera(camera, depth_px))


def stray_images(folder: Path, _color: str, _depth: str) -> tuple[Images, Images]:
    """Return the color images of the video, one for each pose, and their depth images."""
    camera, video = stray_camera(folder).camera, VideoFile(folder / 'rgb.mp4')
    assert camera is not None
    path = folder / 'odometry.csv'
    rows = listing.read_table(path, _STRAY_POSE_COLUMNS, separator=',', num_titles=1)
    rows = rows[: video.num_images or None]  # the last poses may lack an image
    colors, depths = [], []
    for i, (stamp_ns, number) in enumerate(
        zip(_stamps_ns(path, rows[:, 0]).tolist(), rows[:, 1].astype(int).tolist(), strict=True)
    ):
        color = ListedImage(stamp_ns, video.path, partial(video.image, i))
        colors.append(listing.resized_color(color, camera.size_px))
        depth = folder / 'depth' / f'{number:06}.png'
        if depth.is_file():
            depths.append(ListedImage(stamp_ns, depth, partial(_trusted_depth, depth)))
    return tuple(colors), tuple(depths)


def _trusted_depth(path: Path) -> ImageData:
    """Return the (H, W) depth in mm, without pixels of the lowest confidence."""
    depth = decode_depth(read_image_bytes(path), path)
    confidence = path.parents[1] / 'confidence' / path.name
    if not confidence.is_file():
        return depth
    is_low = decode_color(read_image_bytes(confidence), confidence)[..., 0] == 0
    return np.where(is_low, np.uint16(0), depth) if is_low.shape == depth.shape else depth


def stray_truth(path: Path) -> Trajectory:
    """Return the poses of odometry.csv, whose camera axes are y down and z forward."""
    rows = listing.read_table(path, _STRAY_POSE_COLUMNS, separator=',', num_titles=1)
    return listing.quaternion_poses(_stamps_ns(path, rows[:, 0]), rows[:, 5:], rows[:, 2:5])


def stray_imu(folder: Path) -> tuple[NumberTable | None, NumberTable | None]:
    """Return rates (rad/s) and accelerations (m/s^2) of imu.csv.

    The app writes accelerations in g as Core Motion has them, though its documentation states
    m/s^2. Its versions before 2025 write them without gravity, which no SLAM can use.
    """
    path = folder / 'imu.csv'
    if not path.is_file():
        return None, None
    rows = listing.read_table(path, _STRAY_IMU_COLUMNS, separator=',', num_titles=1)
    order = in_order(_stamps_ns(path, rows[:, 0]))
    values = rows[order.positions]
    rates = NumberTable(order.stamps_ns, values[:, 4:])
    length_g = float(np.linalg.norm(np.median(values[:, 1:4], axis=0)))
    if not _GRAVITY_G[0] < length_g < _GRAVITY_G[1]:
        _LOG.warning('%s: accelerations are not in g with gravity and are left out', path)
        return rates, None
    return rates, NumberTable(order.stamps_ns, -_G_MPS2 * values[:, 1:4])


def _stamps_ns(path: Path, stamps_s: FloatArray) -> IntArray:
    """Return stamps (N,) in ns; InputError if one is no time."""
    stamps_ns = np.rint(stamps_s * NS_PER_S)
    if not ((stamps_ns >= 0) & (stamps_ns < END_STAMP_NS)).all():
        raise InputError(f'{path}: a stamp is no time in seconds')
    return stamps_ns.astype(np.int64)
