"""How far a loop may move a keyframe: the drift of the visual odometry on the path in between."""

from __future__ import annotations

import numpy as np

from rgbd_slam.config.place_config import LoopConfig

# Chosen: the corrections of shorter loops are mostly the error of the match at the place.
_MIN_PATH_M = 20.0
_MIN_LOOPS = 3  # chosen: fewer do not tell how much the drift varies
# Chosen: drift beyond so many times the largest drift so far is unusual.
_FACTOR = 5.0
# Chosen: a drift of 0.5 % of the path is usual for every camera.
_USUAL_SHARE = 0.005


class DriftLimit:
    """Tells from the length of the path between two keyframes which drift is possible.

    Args:
        config: The largest drift of any camera.
    """

    def __init__(self, config: LoopConfig) -> None:
        self._config = config
        self._shares: list[float] = []  # correction / path of the long loops closed so far

    def explains(self, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether a camera can have drifted by a rotation and a distance on a path."""
        limit = self._config
        max_rad = np.deg2rad(limit.drift_deg + limit.drift_deg_per_m * path_m)
        max_m = limit.drift_m + limit.drift_share * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def is_usual(self, path_m: float, distance_m: float) -> bool:
        """Return whether the loops so far let expect such a drift; True if they are too few."""
        if len(self._shares) < _MIN_LOOPS:
            return True
        share = max(_USUAL_SHARE, _FACTOR * max(self._shares))
        return distance_m <= self._config.drift_m + share * path_m

    def add(self, path_m: float, distance_m: float) -> None:
        """Learn from a loop that is closed: the length of its path, and its correction."""
        if _MIN_PATH_M <= path_m < np.inf:
            self._shares.append(distance_m / path_m)
