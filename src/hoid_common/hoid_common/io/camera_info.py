"""Conversion of sensor_msgs/CameraInfo, live or from a bag, to a `CameraModel`."""

from __future__ import annotations

import re
from typing import Any, Protocol

import numpy as np

from hoid_common.errors import ConfigError, MessageError, prefixed
from hoid_common.values import DISTORTION_MODELS, EQUIDISTANT, CameraModel

_RECTIFIED = re.compile('(^|[/_])rect', re.IGNORECASE)
# Chosen: K and P count as equal if their focal lengths differ by less than this ratio. The poses
# then change by less than depth noise causes.
_SAME_FOCAL = 0.005


class RawCameraInfo(Protocol):
    """The used fields of sensor_msgs/CameraInfo, which the classes of rclpy and rosbags have."""

    width: int
    height: int
    distortion_model: str
    d: Any  # distortion coefficients in OpenCV's order
    k: Any  # intrinsic matrix K: nine numbers, row by row
    p: Any  # projection matrix P of rectified images: twelve numbers, row by row
    binning_x: int
    binning_y: int
    roi: Any  # sensor_msgs/RegionOfInterest


def camera_from_info(info: RawCameraInfo, image_topic: str = '') -> CameraModel:
    """Return the camera model of the images that a topic carries.

    P describes rectified images, K and D raw ones, and drivers publish the same message beside
    both. P is used if `image_topic` is named like rectified images and P is set, else K and D.
    MessageError if the camera is not calibrated, or no real camera has its values.
    """
    k, p = ([float(value) for value in values] for values in (info.k, info.p))
    distortion = tuple(float(d) for d in info.d)
    if is_rectified(image_topic) and p[0] > 0:
        k, distortion = [*p[0:3], *p[4:7], *p[8:11]], ()
    if any(distortion) and info.distortion_model not in DISTORTION_MODELS:
        raise MessageError(
            f'camera_info has distortion_model "{info.distortion_model}"; '
            f'use one of {", ".join(DISTORTION_MODELS)}'
        )
    fx, _, cx, _, fy, cy, *_ = k
    if not (np.isfinite(k).all() and min(fx, fy) > 0 and min(info.width, info.height) > 0):
        raise MessageError(
            f'camera_info has fx={fx} fy={fy} at {info.width}x{info.height} px; '
            'is the camera calibrated?'
        )
    # As image_geometry does: the region of interest is in pixels of the sensor before binning.
    bin_x, bin_y, roi = max(info.binning_x, 1), max(info.binning_y, 1), info.roi
    width_px, height_px = roi.width or info.width, roi.height or info.height
    cx, cy = cx - roi.x_offset, cy - roi.y_offset
    with prefixed('camera_info: ', MessageError, ConfigError):
        return CameraModel(
            int(width_px) // bin_x, int(height_px) // bin_y,
            fx / bin_x, fy / bin_y, cx / bin_x, cy / bin_y,
            distortion if any(distortion) else (),
            bool(any(distortion) and info.distortion_model == EQUIDISTANT),
        )  # fmt: skip


def is_rectified(image_topic: str) -> bool:
    return _RECTIFIED.search(image_topic) is not None


def rectification_doubt(info: RawCameraInfo, image_topic: str) -> str:
    """Return a warning if it is unclear whether P, or K and D, describe the images, else ''."""
    if is_rectified(image_topic) and any(info.d) and info.p[0] <= 0:
        return (
            f'{image_topic} has the name of rectified images, but camera_info has distortion and '
            'no matrix P: K and the distortion are used; publish P, or one without distortion'
        )
    is_told = is_rectified(image_topic) or 'raw' in image_topic
    if is_told or not any(info.d) or abs(info.p[0] - info.k[0]) <= _SAME_FOCAL * info.k[0]:
        return ''
    return (
        f'camera_info has distortion and a rectified focal length ({info.p[0]:.1f} px for '
        f'{info.k[0]:.1f}); {image_topic or "the color image"} is taken as not rectified: if it '
        'is, publish a camera_info without distortion, or remap the images to a name with "rect"'
    )
