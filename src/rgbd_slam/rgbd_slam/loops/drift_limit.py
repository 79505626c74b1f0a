"""Limits how far a loop may move a keyframe: by the drift on the path between its two ends."""

from __future__ import annotations

import numpy as np

from rgbd_slam.config.place_config import LoopConfig

# Chosen: nothing is learned from loops with a shorter path, whose correction is mostly the error
# of the match at the place.
_MIN_PATH_M = 20.0
_MIN_LOOPS = 3  # chosen: fewer loops do not show how much the drift varies
# Chosen: a drift per length of the path is unusual above this multiple of the largest one so far.
# An unusual loop that moves a keyframe far is closed only if the surroundings agree beyond a room.
_FACTOR = 5.0
# Chosen: a drift of up to 0.5 % of the path is usual for every camera.
_USUAL_SHARE = 0.005
_USUAL_RAD_PER_M = np.deg2rad(0.05)  # chosen: the same for the rotation
# Chosen: places that look alike, such as rooms along a corridor or above each other, are farther
# apart than this, so that a longer path does not explain such a correction by itself.
APART_M = 2.0


class DriftLimit:
    """Decides which drift is possible on a path between two keyframes, and which is usual.

    Args:
        config: Parameters, which contain the largest drift that is possible with any camera.
    """

    def __init__(self, config: LoopConfig) -> None:
        self._config = config
        # Of the long loops closed so far: distance and rotation of the correction, divided by the
        # length of the path.
        self._shares: list[float] = []
        self._turns_rad_per_m: list[float] = []

    def explains(self, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether a camera can have drifted by this rotation and distance on a path.

        The limits grow linearly with the length `path_m`, which is infinite between maps.
        """
        limit = self._config
        max_rad = np.deg2rad(limit.drift_deg + limit.drift_deg_per_m * path_m)
        max_m = limit.drift_m + limit.drift_share * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def is_usual(self, path_m: float, turn_rad: float, distance_m: float) -> bool:
        """Return whether a drift is usual, compared with the loops closed so far.

        Before three loops with a path of 20 m or more have been closed, only what is usual for
        every camera is. A drift of more than 2 m never is.

        Args:
            path_m: Length of the path.
            turn_rad: Rotation of the drift.
            distance_m: Distance of the drift.
        """
        factor = _FACTOR if len(self._shares) >= _MIN_LOOPS else 0.0
        share = max(_USUAL_SHARE, factor * max(self._shares, default=0.0))
        rad_per_m = max(_USUAL_RAD_PER_M, factor * max(self._turns_rad_per_m, default=0.0))
        max_m = min(self._config.drift_m + share * path_m, APART_M)
        max_rad = np.deg2rad(self._config.drift_deg) + rad_per_m * path_m
        return bool(distance_m <= max_m and turn_rad <= max_rad)

    def add(self, path_m: float, turn_rad: float, distance_m: float) -> None:
        """Learn from a closed loop: the length of its path, and its correction.

        Loops with a path shorter than 20 m are ignored.
        """
        if _MIN_PATH_M <= path_m < np.inf:
            self._shares.append(distance_m / path_m)
            self._turns_rad_per_m.append(turn_rad / path_m)
