"""A ring-shaped world of known drift: a lap measures 1 % less than a full turn.

Every view is exactly rigid, so that tracking is exact. The gap at the end of a lap is the drift
that a loop closure has to correct.
"""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import Features, FloatArray
from hoid_system_tests.point_world import CAMERA

_MISSING_SHARE = 0.01  # of a turn
_WALL_M = 3.0
_RING_M = 1.0
_OCTAVE = 2


class BentRing:
    """Points on a round wall; the camera moves on a ring inside it and faces outward."""

    def __init__(self, num_points: int = 3000, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self._angle_rad = rng.uniform(0, 2 * np.pi, num_points)
        self._radius_m = _WALL_M + rng.uniform(-0.5, 0.5, num_points)
        self._height_m = rng.uniform(-1.5, 1.5, num_points)
        self._descriptors = rng.integers(0, 256, (num_points, 32), dtype=np.uint8)

    @property
    def bend_m(self) -> float:
        """Return the shift [m] by which a closed map bends the farthest wall over half a view."""
        half_view_rad = np.arctan(CAMERA.width_px / 2 / CAMERA.fx_px)
        return float(_MISSING_SHARE * half_view_rad * self._radius_m.max())

    def camera_at(self, turn_rad: float) -> FloatArray:
        """Return the (4, 4) T_start_camera as odometry measures it."""
        T_world_start, T_world_camera = (_on_ring(turn) for turn in (0.0, turn_rad))
        return se3.inverse(T_world_start) @ T_world_camera

    def features(self, turn_rad: float, stamp_ns: int) -> Features:
        """Return the features of an image after a turn of any angle."""
        ahead = np.mod(self._angle_rad - turn_rad + np.pi, 2 * np.pi) - np.pi
        angle_rad = _measured(ahead)
        x = self._radius_m * np.sin(angle_rad)
        z = self._radius_m * np.cos(angle_rad) - _RING_M
        points_m = np.stack([x, self._height_m, z], axis=1)
        seen = np.flatnonzero(z > 0.5)
        uv = CAMERA.project_px(points_m[seen])
        inside = ((uv >= 0) & (uv <= (CAMERA.width_px - 1, CAMERA.height_px - 1))).all(axis=1)
        seen, n = seen[inside], int(inside.sum())
        return Features(
            stamp_ns,
            uv[inside].astype(np.float32),
            z[seen].astype(np.float32),
            np.full(n, _OCTAVE, np.uint8),
            np.zeros(n, np.float32),
            np.ones(n, np.float32),
            self._descriptors[seen],
            np.ones(n, np.bool_),
        )


def _measured(angle_rad: FloatArray | float) -> FloatArray | float:
    return (1.0 - _MISSING_SHARE) * angle_rad


def _on_ring(turn_rad: float) -> FloatArray:
    angle = float(_measured(turn_rad))
    T = se3.exp(np.array([0.0, angle, 0, 0, 0, 0]))
    T[:3, 3] = _RING_M * np.sin(angle), 0.0, _RING_M * np.cos(angle)
    return T
