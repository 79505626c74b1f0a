"""An approximate pose of the camera, given by a user or another localization."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray

# Chosen: range of the hint in standard deviations; 99.7 % of a normal distribution.
_NUM_SIGMAS = 3.0
# Not tuned: least distance and rotation from the hint within which the camera is searched for. A
# click on a map in RViz is no more accurate than this distance, whatever its covariance says, and
# views that differ by a larger rotation have little in common.
_MIN_REACH_M = 1.5
_MIN_REACH_RAD = np.pi / 3


@dataclass(frozen=True, eq=False)
class PoseHint:
    """An approximate pose of the camera, around which the camera is searched for.

    Attributes:
        T_map_camera: (4, 4) pose in the core's frame of the main map.
        sigma_m: Standard deviation of the position.
        sigma_rad: Standard deviation of the rotation.
    """

    T_map_camera: FloatArray
    sigma_m: float = 0.0
    sigma_rad: float = 0.0

    def reaches(self, T_map_camera: FloatArray) -> BoolArray:
        """Return the mask (N,) of camera poses (N, 4, 4) that are consistent with the hint."""
        distance_m, turn_rad = self.distances(T_map_camera)
        reach_m = max(_NUM_SIGMAS * self.sigma_m, _MIN_REACH_M)
        reach_rad = max(_NUM_SIGMAS * self.sigma_rad, _MIN_REACH_RAD)
        return np.asarray((distance_m <= reach_m) & (turn_rad <= reach_rad))

    def distances(self, T_map_camera: FloatArray) -> FloatArray:
        """Return the distances and rotations (2, N) in m, rad of poses (N, 4, 4) from the hint."""
        rotation = se3.log(se3.inverse(self.T_map_camera) @ T_map_camera)[:, :3]
        offset_m = T_map_camera[:, :3, 3] - self.T_map_camera[:3, 3]
        return np.stack([np.linalg.norm(offset_m, axis=1), np.linalg.norm(rotation, axis=1)])
