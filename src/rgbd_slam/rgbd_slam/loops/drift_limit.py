"""The drift that is possible, or usual, on the path between the two keyframes of a loop."""

from __future__ import annotations

import numpy as np

from rgbd_slam.config.place_config import LoopConfig

# Chosen: the correction of a loop with a shorter path is mostly the error of the match.
_MIN_PATH_M = 20.0
_MIN_LOOPS = 3  # chosen: fewer loops do not show how much the drift varies
# Chosen: a drift per length of the path is unusual above this multiple of the largest one so far.
_FACTOR = 5.0
# Chosen: a drift of up to 0.5 % of the path is usual for every camera.
_USUAL_SHARE = 0.005
_USUAL_RAD_PER_M = np.deg2rad(0.05)  # chosen: the same for the rotation
# Chosen: places that look alike, such as rooms along a corridor or above each other, are farther
# apart than this, so that a longer path does not explain such a correction by itself.
APART_M = 2.0


class DriftLimit:
    """Learns the drift of the camera from closed loops."""

    def __init__(self, config: LoopConfig) -> None:
        self._config = config
        # Corrections of the long loops closed so far, divided by the length of their path.
        self._shares: list[float] = []
        self._turns_rad_per_m: list[float] = []

    def is_possible(self, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether a camera can have drifted by this rotation and distance on a path."""
        limit = self._config
        max_rad = np.deg2rad(limit.drift_deg + limit.drift_deg_per_m * path_m)
        max_m = limit.drift_m + limit.drift_share * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def is_usual(self, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether a drift is within five times the largest one of the loops so far.

        Before three long loops, it must be usual for every camera; more than 2 m never is.
        """
        factor = _FACTOR if len(self._shares) >= _MIN_LOOPS else 0.0
        share = max(_USUAL_SHARE, factor * max(self._shares, default=0.0))
        rad_per_m = max(_USUAL_RAD_PER_M, factor * max(self._turns_rad_per_m, default=0.0))
        max_m = min(self._config.drift_m + share * path_m, APART_M)
        max_rad = np.deg2rad(self._config.drift_deg) + rad_per_m * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def learn(self, path_m: float, turn_rad: float, distance_m: float) -> None:
        """Learn the correction of a closed loop, unless its path is shorter than 20 m."""
        if _MIN_PATH_M <= path_m < np.inf:
            self._shares.append(distance_m / path_m)
            self._turns_rad_per_m.append(turn_rad / path_m)
