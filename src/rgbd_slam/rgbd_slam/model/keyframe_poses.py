"""Where the keyframes of all maps are, at one version of the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, FloatArray, IntArray


class KeyframePoses(NamedTuple):
    """Where the keyframes of all maps are, as the map says at one time; by ascending uid.

    Only the main map's poses are in the map frame: nothing says where other maps lie.
    """

    version: int  # of the map; grows
    uids: IntArray  # (N,)
    map_ids: IntArray  # (N,)
    main_map: int
    T_map_camera: FloatArray  # (N, 4, 4)

    @property
    def is_main(self) -> BoolArray:
        """Return the (N,) mask of keyframes in the main map."""
        return np.equal(self.map_ids, self.main_map)

    def rows_of(self, uids: IntArray) -> IntArray:
        """Return the (M,) rows of keyframes that are there."""
        return np.searchsorted(self.uids, uids)


NO_KEYFRAMES = KeyframePoses(
    0, np.empty(0, np.int64), np.empty(0, np.int64), 0, np.empty((0, 4, 4))
)
