"""An approximate pose of the camera, given by a user or another localization."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray

_NUM_SIGMAS = 3.0  # chosen: 99.7 % of a normal distribution
# Not tuned: smallest distance and rotation within which the camera is searched. A click on a map
# in RViz is no more accurate than this distance, whatever its covariance is, and views that differ
# by a larger rotation have little in common.
_MIN_REACH_M = 1.5
_MIN_REACH_RAD = np.pi / 3


@dataclass(frozen=True, eq=False)
class PoseHint:
    """An approximate pose of the camera, which limits where the camera is searched.

    Attributes:
        T_map_camera: (4, 4) pose in the core's frame of the main map.
        sigma_m: Standard deviation of its position.
        sigma_rad: Standard deviation of its rotation.
    """

    T_map_camera: FloatArray
    sigma_m: float = 0.0
    sigma_rad: float = 0.0

    def reaches(self, T_map_camera: FloatArray) -> BoolArray:
        """Return the (N,) mask of camera poses (N, 4, 4) that are consistent with the hint."""
        distance_m, turn_rad = self.distances(T_map_camera)
        reach_m = max(_NUM_SIGMAS * self.sigma_m, _MIN_REACH_M)
        reach_rad = max(_NUM_SIGMAS * self.sigma_rad, _MIN_REACH_RAD)
        return np.asarray((distance_m <= reach_m) & (turn_rad <= reach_rad))

    def distances(self, T_map_camera: FloatArray) -> FloatArray:
        """Return the (2, N) distances [m] and rotations [rad] of poses (N, 4, 4) from the hint."""
        rotation = se3.log(se3.inverse(self.T_map_camera) @ T_map_camera)[:, :3]
        offset_m = T_map_camera[:, :3, 3] - self.T_map_camera[:3, 3]
        return np.stack([np.linalg.norm(offset_m, axis=1), np.linalg.norm(rotation, axis=1)])
