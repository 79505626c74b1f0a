"""From the map's frame to the camera's, on coordinates as rows: arrays are (3, N)."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray

MIN_DEPTH_M = 0.05  # nearer points are not projected; the kernels' limit as well


def to_camera(T_camera_map: FloatArray, points_m: FloatArray) -> FloatArray:
    """Return (3, N) points of the map's frame in the camera's."""
    return np.asarray(T_camera_map[:3, :3] @ points_m + T_camera_map[:3, 3, None])
