"""The poses of all keyframes at one version of the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, FloatArray, IntArray


class KeyframePoses(NamedTuple):
    """Snapshot of the poses of all keyframes, sorted by ascending uid.

    Only the poses of the main map are in the map frame. Other maps have frames of their own, whose
    poses relative to the map frame are unknown.
    """

    version: int  # of the map; increases with every change
    uids: IntArray  # (N,)
    map_ids: IntArray  # (N,)
    main_map: int  # id of the map with most keyframes
    T_map_camera: FloatArray  # (N, 4, 4)

    @property
    def is_main(self) -> BoolArray:
        """Return the (N,) mask of the keyframes in the main map."""
        return np.equal(self.map_ids, self.main_map)

    def rows_of(self, uids: IntArray) -> IntArray:
        """Return the rows (M,) of the keyframes with given uids (M,).

        All must be in the snapshot: a missing uid is not noticed, and its row is wrong.
        """
        return np.searchsorted(self.uids, uids)


NO_KEYFRAMES = KeyframePoses(
    0, np.empty(0, np.int64), np.empty(0, np.int64), 0, np.empty((0, 4, 4))
)
