"""Transforms points from the map frame to the camera frame, as rows of coordinates (3, N)."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray


def to_camera(T_camera_map: FloatArray, points_m: FloatArray) -> FloatArray:
    """Return (3, N) points in the camera frame for (3, N) points in the map frame."""
    return np.asarray(T_camera_map[:3, :3] @ points_m + T_camera_map[:3, 3, None])
