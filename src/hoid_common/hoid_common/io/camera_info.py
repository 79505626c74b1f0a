"""Conversion of sensor_msgs/CameraInfo, live or from a bag, to a `CameraModel`."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from hoid_common.errors import ConfigError, MessageError
from hoid_common.values import DISTORTION_MODELS, CameraModel


class RawCameraInfo(Protocol):
    """The fields of sensor_msgs/CameraInfo that are used, of rclpy's or of rosbags' class."""

    width: int
    height: int
    distortion_model: str
    d: Any  # distortion coefficients in OpenCV's order
    k: Any  # intrinsic matrix K: nine numbers, row by row
    binning_x: int
    binning_y: int
    roi: Any  # sensor_msgs/RegionOfInterest


def camera_from_info(info: RawCameraInfo) -> CameraModel:
    """Return the camera model of the raw image, from K and D.

    Raises:
        MessageError: The camera is not calibrated, has an unsupported distortion model or too many
            coefficients, or uses binning or a region of interest, which K does not describe.
    """
    distortion = tuple(float(d) for d in info.d)
    if any(distortion) and info.distortion_model not in DISTORTION_MODELS:
        raise MessageError(
            f'camera_info has distortion_model "{info.distortion_model}"; '
            f'use one of {", ".join(DISTORTION_MODELS)}'
        )
    if max(info.binning_x, info.binning_y) > 1 or info.roi.x_offset or info.roi.y_offset:
        raise MessageError(
            'camera_info has binning or a region of interest; publish the full image'
        )
    fx, _, cx, _, fy, cy, *_ = k = [float(value) for value in info.k]
    if not (np.isfinite(k).all() and min(fx, fy) > 0 and min(info.width, info.height) > 0):
        raise MessageError(
            f'camera_info has fx={fx} fy={fy} at {info.width}x{info.height} px; '
            'is the camera calibrated?'
        )
    size_px = int(info.width), int(info.height)
    try:
        return CameraModel(*size_px, fx, fy, cx, cy, distortion if any(distortion) else ())
    except ConfigError as error:
        raise MessageError(f'camera_info: {error}') from error
