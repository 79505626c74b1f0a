"""The height of the floor in each submap, because drift bends the floor of a large map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_common import se3
from hoid_scene.dense.submap import Submap, transform
from hoid_scene.grid.floor import Floor

# Chosen: the floor of a submap is searched for within this height difference from the floor of the
# nearest submap: less than a step of stairs, and more than the drift over a few meters.
_BAND_M = 0.1
_MIN_VOXELS = 100  # not tuned: fewer voxels show no floor


class LocalFloors:
    """Determines the height of the floor in each submap above one plane."""

    def __init__(self, floor: Floor) -> None:
        self.floor = floor
        # Cached for the submaps of the last call: revision, expected height [m], and height of the
        # submap's own floor [m] (NaN: it shows none).
        self._seen: dict[Submap, tuple[int, float, float]] = {}

    def heights_m(self, submaps: Sequence[Submap]) -> dict[Submap, float]:
        """Return the height [m] of the floor of each submap above the plane.

        It is the median height of the shown voxels within 0.1 m of the expected floor, or the
        expected height if these are too few. The expected height is the height of the nearest of
        the preceding submaps in `submaps` that show the floor, or 0 without such a submap.
        """
        T_floor_map = se3.inverse(self.floor.T_map_floor)
        out: dict[Submap, float] = {}
        places, heights_m = np.empty((len(submaps), 2)), np.empty(len(submaps))
        known = 0
        before, self._seen = self._seen, {}
        for submap in submaps:
            T = T_floor_map @ submap.T_map_submap
            place = (T[:3, :3] @ submap.center_m + T[:3, 3])[:2]
            nearest_m = 0.0
            if known:
                gap = np.abs(places[:known] - place).max(axis=1)
                nearest_m = float(heights_m[np.argmin(gap)])
            seen = before.get(submap)
            if seen is None or seen[:2] != (submap.revision, nearest_m):
                above_m = transform(T, submap.points_m())[submap.is_shown(), 2]
                above_m = above_m[np.abs(above_m - nearest_m) < _BAND_M]
                own_m = float(np.median(above_m)) if len(above_m) >= _MIN_VOXELS else np.nan
                seen = submap.revision, nearest_m, own_m
            self._seen[submap] = seen
            out[submap] = nearest_m if np.isnan(seen[2]) else seen[2]
            if not np.isnan(seen[2]):
                places[known], heights_m[known] = place, seen[2]
                known += 1
        return out
