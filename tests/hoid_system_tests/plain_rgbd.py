"""A depth camera from an ordinary ROS shell, without the transport profile of the suite.

    python -m hoid_system_tests.plain_rgbd KIND

It publishes color, depth and camera_info at 10 Hz until it is stopped. KIND says how depth comes.
"""

from __future__ import annotations

import gzip
import os
import struct
import subprocess
import sys
import time
from typing import Any

import cv2
import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

COLOR_K = (500.0, 500.0, 319.5, 239.5)
OWN_K, OWN_PX = (190.0, 190.0, 159.5, 89.5), (320, 180)  # of depth that is not registered
X_M = 0.015  # position of the depth camera in the frame of color
DEPTH_MM = (1000 + np.arange(640) % 500)[None].repeat(480, axis=0).astype(np.uint16)
OWN_MM = (1000 + np.arange(320) % 500)[None].repeat(180, axis=0).astype(np.uint16)
HALF_MM = DEPTH_MM[::2, ::2].copy()
KINDS = ('raw', 'half', 'own frame', 'png', 'tiff', 'zstd', 'camera_info of twice the size')
TOPICS = {'png': '/depth/image/compressedDepth', 'tiff': '/depth/image/compressed',
          'zstd': '/depth/image/zstd'}  # fmt: skip
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'ROS_AUTOMATIC_DISCOVERY_RANGE')
_COLOR, _OWN = 'camera_color_optical_frame', 'camera_depth_optical_frame'


def start_plain_rgbd(kind: str) -> subprocess.Popen[bytes]:
    """Start the camera without the suite's transport profile, and return its process."""
    environment = {k: v for k, v in os.environ.items() if k not in _VARIABLES}
    return subprocess.Popen([sys.executable, '-m', __name__, kind], env=environment)


def image(pixels: NDArray[Any], encoding: str, header: Header) -> Image:
    """Return a raw image."""
    return Image(
        header=header, height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
        step=pixels.strides[0], data=pixels.tobytes(),
    )  # fmt: skip


def info(size_px: tuple[int, int], k: tuple[float, ...], header: Header) -> CameraInfo:
    """Return the camera_info of a camera without distortion."""
    fx, fy, cx, cy = k
    return CameraInfo(
        header=header, width=size_px[0], height=size_px[1], distortion_model='plumb_bob',
        d=[0.0] * 5, k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )  # fmt: skip


def packed(kind: str, header: Header) -> CompressedImage:
    """Return depth as one of the plugins of image_transport packs it."""
    if kind == 'zstd':
        head = struct.pack('<IIBII', 480, 640, 0, 1280, 5) + b'16UC1'
        data = head + gzip.compress(DEPTH_MM.tobytes(), 1)
        return CompressedImage(header=header, format='zstd', data=data)
    content = cv2.imencode(f'.{kind}', DEPTH_MM)[1].tobytes()
    if kind == 'tiff':
        return CompressedImage(header=header, format='16UC1; tiff compressed ', data=content)
    return CompressedImage(
        header=header, format='16UC1; compressedDepth png', data=bytes(12) + content
    )


def main() -> None:
    """Publish until the process is stopped."""
    kind = sys.argv[1]
    rclpy.init()
    node = rclpy.create_node('plain_rgbd')
    rng = np.random.default_rng(3)
    coarse = rng.integers(0, 256, (60, 80, 3), dtype=np.uint8)
    color = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    colors = node.create_publisher(Image, '/rgb/image', 10)
    infos = node.create_publisher(CameraInfo, '/rgb/camera_info', 10)
    type_ = CompressedImage if kind in TOPICS else Image
    depths = node.create_publisher(type_, TOPICS.get(kind, '/depth/image'), 10)
    if kind == 'own frame':
        own_infos = node.create_publisher(CameraInfo, '/depth/camera_info', 10)
        frames = node.create_publisher(TFMessage, '/tf_static', latched)
        edge = TransformStamped(child_frame_id=_OWN)
        edge.header.frame_id, edge.transform.translation.x = _COLOR, X_M
        frames.publish(TFMessage(transforms=[edge]))
    while True:
        stamp = node.get_clock().now().to_msg()
        header, own = Header(stamp=stamp, frame_id=_COLOR), Header(stamp=stamp, frame_id=_OWN)
        if kind == 'camera_info of twice the size':
            infos.publish(info((1280, 960), (1000.0, 1000.0, 639.5, 479.5), header))
        else:
            infos.publish(info((640, 480), COLOR_K, header))
        colors.publish(image(color, 'bgr8', header))
        if kind in TOPICS:
            depths.publish(packed(kind, header))
        elif kind == 'own frame':
            own_infos.publish(info(OWN_PX, OWN_K, own))
            depths.publish(image(OWN_MM, '16UC1', own))
        else:
            depths.publish(image(HALF_MM if kind == 'half' else DEPTH_MM, '16UC1', header))
        time.sleep(0.1)


if __name__ == '__main__':
    main()
