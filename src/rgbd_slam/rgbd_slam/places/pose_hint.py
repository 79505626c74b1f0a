"""Where somebody says that the camera is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray

_SIGMAS = 3.0
# A click on a map says no more than this, whatever covariance it comes with; views that are
# turned by more have little in common.
_LEAST_REACH_M = 1.5
_LEAST_REACH_RAD = np.pi / 3


@dataclass(frozen=True, eq=False)
class PoseHint:
    """A pose that was given, and how far from it the camera is looked for.

    Args:
        T_map_camera: (4, 4).
        sigma_m: Standard deviation of the place.
        sigma_rad: Of the direction.
    """

    T_map_camera: FloatArray
    sigma_m: float = 0.0
    sigma_rad: float = 0.0

    def reaches(self, T_map_camera: FloatArray) -> BoolArray:
        """Return the (N,) mask of poses (N, 4, 4) at which the camera may be."""
        apart = self.apart(T_map_camera)
        reach_m = max(_SIGMAS * self.sigma_m, _LEAST_REACH_M)
        reach_rad = max(_SIGMAS * self.sigma_rad, _LEAST_REACH_RAD)
        return np.asarray((apart[0] <= reach_m) & (apart[1] <= reach_rad))

    def apart(self, T_map_camera: FloatArray) -> FloatArray:
        """Return (2, N) how far poses (N, 4, 4) are away [m] and turned [rad]."""
        turned = se3.log(se3.inverse(self.T_map_camera) @ T_map_camera)[:, :3]
        away = T_map_camera[:, :3, 3] - self.T_map_camera[:3, 3]
        return np.stack([np.linalg.norm(away, axis=1), np.linalg.norm(turned, axis=1)])
