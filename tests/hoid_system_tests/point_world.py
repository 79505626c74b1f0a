"""A world of points with unique descriptors, whose features are known exactly."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import CameraModel, Features, FloatArray

CAMERA = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)


def pose_after(i: int, turn_rad: float) -> FloatArray:
    """Return the (4, 4) T_world_camera after i steps of 1 cm right, 5 mm forward and a turn."""
    T = se3.exp(np.array([0.0, turn_rad * i, 0, 0, 0, 0]))
    T[:3, 3] = 0.01 * i, 0.0, 0.005 * i
    return T


class PointWorld:
    """Points in front of the first camera, in its optical frame."""

    def __init__(self, num_points: int = 1500, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        low, high = (-3.0, -2.0, 1.2), (3.0, 2.0, 4.0)
        self.points_m = rng.uniform(low, high, (num_points, 3))
        self.descriptors = rng.integers(0, 256, (num_points, 32), dtype=np.uint8)

    def features(self, T_world_camera: FloatArray, stamp_ns: int) -> Features:
        """Return the features of an image taken at a (4, 4) pose."""
        points_m = se3.transform(se3.inverse(T_world_camera), self.points_m)
        ahead = np.flatnonzero(points_m[:, 2] > 0.3)
        uv = CAMERA.project_px(points_m[ahead])
        inside = ((uv >= 0) & (uv <= (CAMERA.width_px - 1, CAMERA.height_px - 1))).all(axis=1)
        seen, n = ahead[inside], int(inside.sum())
        return Features(
            stamp_ns,
            uv[inside].astype(np.float32),
            points_m[seen, 2].astype(np.float32),
            np.zeros(n, np.uint8),
            np.zeros(n, np.float32),
            np.ones(n, np.float32),
            self.descriptors[seen],
            np.ones(n, np.bool_),
        )
