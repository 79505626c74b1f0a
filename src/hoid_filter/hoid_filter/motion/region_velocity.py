"""Velocities of moving regions, from the displacements of the points tracked on them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray, IntArray
from hoid_filter.motion.motion_log_odds import LabeledRegions

# Chosen: over a shorter time the depth noise of a point exceeds its displacement.
_MIN_ELAPSED_S = 0.1
_MIN_POINTS = 3  # the fewest whose median ignores one outlier


class PointDisplacements(NamedTuple):
    """Displacements of N tracked points in the world since their earlier positions."""

    downscaled_pixel: IntArray  # (N,) indices into the flattened downscaled depth image
    displacement_m: FloatArray  # (N, 3) relative to the world, along camera axes
    elapsed_s: FloatArray  # (N,) time since the earlier position, which differs between points

    @staticmethod
    def none() -> PointDisplacements:
        return PointDisplacements(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0))

    def region_velocities_mps(self, regions: LabeledRegions) -> FloatArray:
        """Return the velocities (R, 3) of regions in the world, along camera axes; or NaN."""
        velocities_mps = np.full((regions.num_regions, 3), np.nan)
        is_long = self.elapsed_s >= _MIN_ELAPSED_S
        point_mps = self.displacement_m[is_long] / self.elapsed_s[is_long, None]
        region_of_point = regions.label.ravel()[self.downscaled_pixel[is_long]]
        for n in range(regions.num_regions):
            inside_mps = point_mps[region_of_point == n + 1]
            if len(inside_mps) >= _MIN_POINTS:
                velocities_mps[n] = np.median(inside_mps, axis=0)
        return velocities_mps
