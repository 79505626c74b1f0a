"""sensor_msgs/CameraInfo."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.values import CameraModel

_MODELS = ('plumb_bob', 'rational_polynomial')


def camera_from_msg(msg: CameraInfo) -> CameraModel:
    """Return the camera that took the pictures (K and D); binning and ROIs are refused."""
    if any(msg.d) and msg.distortion_model not in _MODELS:
        raise MessageError(
            f'camera_info has distortion_model "{msg.distortion_model}"; '
            f'use one of {", ".join(_MODELS)}'
        )
    if max(msg.binning_x, msg.binning_y) > 1 or msg.roi.x_offset or msg.roi.y_offset:
        raise MessageError(
            'camera_info has binning or a region of interest; publish the full image'
        )
    k = np.array(msg.k)
    if not (np.isfinite(k).all() and min(k[0], k[4]) > 0 and min(msg.width, msg.height) > 0):
        raise MessageError(
            f'camera_info has fx={k[0]} fy={k[4]} at {msg.width}x{msg.height} px; '
            'is the camera calibrated?'
        )
    distortion = tuple(float(d) for d in msg.d) if any(msg.d) else ()
    return CameraModel(
        msg.width, msg.height, float(k[0]), float(k[4]), float(k[2]), float(k[5]), distortion
    )


def camera_to_msg(camera: CameraModel, header: Header) -> CameraInfo:
    """Return the message of a camera whose pictures are not rectified."""
    K = camera.matrix.ravel().tolist()
    P = np.hstack([camera.matrix, np.zeros((3, 1))]).ravel().tolist()
    distortion = list(camera.distortion) or [0.0] * 5
    return CameraInfo(
        header=header,
        height=camera.height_px,
        width=camera.width_px,
        distortion_model='rational_polynomial' if len(distortion) > 5 else 'plumb_bob',
        d=distortion,
        k=K,
        r=np.eye(3).ravel().tolist(),
        p=P,
    )
