"""How fast what moves goes, by the points on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.median import median
from hoid_common.values import FloatArray, IntArray
from hoid_filter.motion.belief import MovingArea

_LEAST_S = 0.1  # in which a point that moves outdoes the noise of its depth
_LEAST_POINTS = 3  # that tell how a region goes


class Course(NamedTuple):
    """Where N points went since they were anchored."""

    small_pixel: IntArray  # (N,) flat, in the small depth image
    way_m: FloatArray  # (N, 3) against the world, along the camera's axes
    since_s: FloatArray  # (N,)

    @staticmethod
    def none() -> Course:
        """Return that of no points."""
        return Course(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0))

    def velocities_mps(self, area: MovingArea) -> FloatArray:
        """Return (R, 3) of what moves, along the camera's axes; NaN = unknown.

        It is that of the region's points over the last tenths of a second, each axis' median.
        """
        found = np.full((area.num_regions, 3), np.nan)
        told = self.since_s >= _LEAST_S
        velocity_mps = self.way_m[told] / self.since_s[told, None]
        of_point = area.label.ravel()[self.small_pixel[told]]
        for n in range(area.num_regions):  # a handful
            own_mps = velocity_mps[of_point == n + 1]
            if len(own_mps) >= _LEAST_POINTS:
                found[n] = median(own_mps)
        return found
