"""Conversion of camera intrinsics: sensor_msgs/CameraInfo."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from hoid_common.values import CameraModel


def camera_to_msg(camera: CameraModel, header: Header) -> CameraInfo:
    """Return the CameraInfo of a camera whose images are not rectified (R = I, P = [K 0])."""
    K = camera.matrix.ravel().tolist()
    P = np.hstack([camera.matrix, np.zeros((3, 1))]).ravel().tolist()
    distortion = list(camera.distortion) or [0.0] * 5
    return CameraInfo(
        header=header,
        height=camera.height_px,
        width=camera.width_px,
        distortion_model=camera.distortion_model,
        d=distortion,
        k=K,
        r=np.eye(3).ravel().tolist(),
        p=P,
    )
