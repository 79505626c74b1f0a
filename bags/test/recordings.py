"""Recordings in the layouts of phones, scanners and renderers, small and synthetic."""

from __future__ import annotations

import json
import struct
import zlib
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import CameraModel, FloatArray

NUM = 4
# Poses T_world_camera of cameras with y down and z forward: each turns and moves differently.
POSES: FloatArray = np.array(
    [
        se3.exp(np.array([0.1 * i, 0.3 * i, -0.2 * i, 0.05 * i, 0.1 * i, -0.07 * i]))
        for i in range(NUM)
    ]
)
_Y_UP = np.diag([1.0, -1.0, 1.0, 1.0])
_ARKIT = np.diag([1.0, -1.0, -1.0, 1.0])
PHONE_DEPTH_MM = (1000 + 7 * np.arange(48 * 64) % 1500).reshape(48, 64).astype(np.uint16)
# 7.5 times the size of depth, as an iPhone's 1920x1440 and 256x192.
PHONE = CameraModel(480, 360, 450.0, 451.0, 239.5, 179.5)
# The same view at three times the size of depth: 192 / 480 = 144 / 360 = 0.4.
PHONE_SHRUNK = CameraModel(192, 144, 180.0, 180.4, 95.5, 71.5)
ICL_DEPTH_M: NDArray[np.floating] = (1.0 + 0.001 * (np.arange(480 * 640) % 1500)).reshape(480, 640)
STAMPS_S = 100 + np.arange(NUM) / 60


def color(i: int, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    return np.full((size_px[1], size_px[0], 3), 50 + 16 * i, np.uint8)


def quaternion_rows(poses: FloatArray) -> list[list[float]]:
    """Return the rows qx qy qz qw tx ty tz of poses."""
    rotations = se3.quat_xyzw_from_rotation(poses[:, :3, :3])
    rows: list[list[float]] = np.hstack([rotations, poses[:, :3, 3]]).tolist()
    return rows


def write(path: Path, pixels: NDArray[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


def exr(depth_m: NDArray[np.float32], compression: int, kinds: str = 'f') -> bytes:
    """Return an OpenEXR image with depth in channel R, of channels B, G, R if there are three.

    Args:
        compression: 0 none, 2 ZIPS (a line each), 3 ZIP (16 lines).
        kinds: 'f' (32-bit) or 'e' (16-bit) of each channel.
    """
    height, width = depth_m.shape
    names = 'R' if len(kinds) == 1 else 'BGR'
    types = {'f': 2, 'e': 1}
    channels = b''.join(
        name.encode() + b'\0' + struct.pack('<iB3xii', types[kind], 0, 1, 1)
        for name, kind in zip(names, kinds, strict=True)
    )
    box = struct.pack('<4i', 0, 5, width - 1, height + 4)  # the first row has number 5
    attributes = {
        'channels': ('chlist', channels + b'\0'),
        'compression': ('compression', bytes([compression])),
        'dataWindow': ('box2i', box),
        'displayWindow': ('box2i', box),
        'lineOrder': ('lineOrder', b'\0'),
        'pixelAspectRatio': ('float', struct.pack('<f', 1)),
        'screenWindowCenter': ('v2f', bytes(8)),
        'screenWindowWidth': ('float', struct.pack('<f', 1)),
    }
    head = b'\x76\x2f\x31\x01\x02\0\0\0' + b''.join(
        name.encode() + b'\0' + kind.encode() + b'\0' + struct.pack('<i', len(value)) + value
        for name, (kind, value) in attributes.items()
    )
    head += b'\0'
    lines = 16 if compression == 3 else 1
    blocks = []
    for top in range(0, height, lines):
        rows = b''.join(
            (row if name == 'R' else 0 * row).astype(f'<{kind}').tobytes()
            for row in depth_m[top : top + lines]
            for name, kind in zip(names, kinds, strict=True)
        )
        packed = exr_packed(rows) if compression else rows
        data = packed if len(packed) < len(rows) else rows
        blocks.append(struct.pack('<iI', top + 5, len(data)) + data)
    at = len(head) + 8 * len(blocks)
    table = b''
    for block in blocks:
        table += struct.pack('<Q', at)
        at += len(block)
    return head + table + b''.join(blocks)


def exr_packed(rows: bytes) -> bytes:
    """Return bytes as ZIP of OpenEXR: even bytes, then odd ones, each minus its neighbor."""
    split = rows[0::2] + rows[1::2]
    differences = [
        split[0],
        *((b - a + 128) % 256 for a, b in pairwise(split)),
    ]
    return zlib.compress(bytes(differences))


def record3d(folder: Path) -> None:
    for i in range(NUM):
        write(folder / f'rgb/{i}.jpg', color(i, PHONE.size_px))
        depth = folder / f'depth/{i}.exr'
        depth.parent.mkdir(exist_ok=True)
        depth.write_bytes(exr((PHONE_DEPTH_MM / 1000).astype(np.float32), 3))
    K = [PHONE.fx_px, 0, 0, 0, PHONE.fy_px, 0, PHONE.cx_px, PHONE.cy_px, 1]
    metadata = {
        'w': PHONE.width_px, 'h': PHONE.height_px, 'K': K, 'fps': 60,
        'poses': quaternion_rows(POSES @ _ARKIT), 'frameTimestamps': STAMPS_S.tolist(),
    }  # fmt: skip
    (folder / 'metadata.json').write_text(json.dumps(metadata))


def stray(folder: Path, gravity: float = 1.0) -> None:
    """Write a recording of Stray Scanner, with a pixel (0, 0) of the lowest confidence."""
    import av  # noqa: PLC0415 - optional

    with av.open(str(folder / 'rgb.mp4'), 'w') as container:
        stream: Any = container.add_stream('libx265', rate=60)
        stream.width, stream.height, stream.pix_fmt = *PHONE.size_px, 'yuv420p'
        stream.options = {'preset': 'ultrafast', 'x265-params': 'log-level=none:crf=1'}
        for i in range(NUM):
            frame = av.VideoFrame.from_ndarray(color(i, PHONE.size_px), format='bgr24')
            frame.pts, frame.time_base = i, Fraction(1, 60)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    lines = ['timestamp, frame, x, y, z, qx, qy, qz, qw']
    for i, (qx, qy, qz, qw, x, y, z) in enumerate(quaternion_rows(POSES)):
        lines.append(f'{STAMPS_S[i]}, {i:06}, {x}, {y}, {z}, {qx}, {qy}, {qz}, {qw}')
        write(folder / f'depth/{i:06}.png', PHONE_DEPTH_MM)
        confidence = np.full(PHONE_DEPTH_MM.shape, 2, np.uint8)
        confidence[0, 0] = 0
        write(folder / f'confidence/{i:06}.png', confidence)
    (folder / 'odometry.csv').write_text('\n'.join(lines))
    K = PHONE.matrix
    (folder / 'camera_matrix.csv').write_text('\n'.join(', '.join(map(str, row)) for row in K))
    lines = ['timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z']
    lines += [f'{100 + 0.01 * i}, 0, 0, {-gravity}, 0.1, 0.2, 0.3' for i in range(10)]
    (folder / 'imu.csv').write_text('\n'.join(lines))


SENS_COLOR = CameraModel(128, 96, 120.0, 120.0, 63.5, 47.5)
SENS_DEPTH = CameraModel(64, 48, 57.0, 57.0, 31.5, 23.5)
SENS_SHRUNK = CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5)
SENS_MM = 1500
LOST = 2  # the frame at which the scanner does not know its place


def sens(folder: Path, *, is_packed: bool = True) -> None:
    """Write a file of ScanNet, whose depth shows a wall and has another camera than color."""
    with (folder / 'scene0000_00.sens').open('wb') as file:
        file.write(struct.pack('<IQ', 4, 9) + b'structure')
        for camera in (SENS_COLOR, SENS_DEPTH):
            K = np.eye(4, dtype='<f4')
            K[:3, :3] = camera.matrix
            file.write(K.tobytes() + np.eye(4, dtype='<f4').tobytes())
        sizes = *SENS_COLOR.size_px, *SENS_DEPTH.size_px
        file.write(struct.pack('<ii4IfQ', 2, int(is_packed), *sizes, 1000.0, NUM))
        for i in range(NUM):
            T = np.full((4, 4), -np.inf) if i == LOST else POSES[i]
            jpeg = cv2.imencode('.jpg', color(i, SENS_COLOR.size_px))[1].tobytes()
            wall = np.full(SENS_DEPTH.size_px[::-1], SENS_MM, '<u2').tobytes()
            depth = zlib.compress(wall) if is_packed else wall
            stamps = (round(1e6 * STAMPS_S[i]),) * 2
            file.write(T.astype('<f4').tobytes())
            file.write(struct.pack('<4Q', *stamps, len(jpeg), len(depth)) + jpeg + depth)
        file.write(struct.pack('<Q', 10))
        for i in range(10):
            file.write(struct.pack('<3d96xQ', 0.1, 0.2, 0.3, 100_000_000 + 10_000 * i))


def icl_nuim(folder: Path) -> None:
    """Write images 1 to NUM in the layout of TUM; the last pose has no image."""
    lines, poses = [], []
    for i in range(NUM):
        write(folder / f'rgb/{i + 1}.png', color(i, (640, 480)))
        write(folder / f'depth/{i + 1}.png', np.rint(5000 * ICL_DEPTH_M).astype(np.uint16))
        lines.append(f'{i + 1} depth/{i + 1}.png {i + 1} rgb/{i + 1}.png')
    for i, (qx, qy, qz, qw, x, y, z) in enumerate(quaternion_rows(_Y_UP @ POSES @ _Y_UP)):
        poses.append(f'{i + 1} {x} {y} {z} {qx} {qy} {qz} {qw}')
    (folder / 'associations.txt').write_text('\n'.join(lines))
    (folder / 'livingRoom1.gt.freiburg').write_text('\n'.join(poses))


def icl_scene(folder: Path) -> None:
    """Write images 0 to NUM - 1 as POV-Ray made them; depth is the distance along the ray."""
    x = (np.arange(640) - 319.5) / 481.2
    y = (np.arange(480) - 239.5) / -480.0
    distance_m = ICL_DEPTH_M * np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + 1)
    for i, T in enumerate(_Y_UP @ POSES @ _Y_UP):
        name = f'scene_00_{i:04}'
        write(folder / f'{name}.png', color(i, (640, 480)))
        (folder / f'{name}.depth').write_text(' '.join(f'{d:.5f}' for d in distance_m.ravel()))
        vectors = {'pos': T[:3, 3], 'dir': T[:3, 2], 'up': T[:3, 1], 'right': 1.33 * T[:3, 0]}
        lines = [f"cam_{n} = [{', '.join(map(str, v))}]';" for n, v in vectors.items()]
        (folder / f'{name}.txt').write_text('\n'.join([*lines, 'cam_angle = 90;']))
