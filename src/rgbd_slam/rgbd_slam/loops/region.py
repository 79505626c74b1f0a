"""The part of a map that a loop changes: keyframes near its ends, and the border around these."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_tables import NEAR_SHARED


class Region(NamedTuple):
    """Connected keyframes of one map."""

    rows: IntArray  # (N,) ascending
    # (M,) ascending: keyframes outside the region that share at least 15 points with one inside,
    # or are its parent or child in the spanning tree. A correction of the region does not move
    # them.
    border: IntArray


def region_around(atlas: Atlas, starts: IntArray, limit: int) -> Region:
    """Return the region of at most `limit` keyframes that are nearest to given keyframes.

    Near keyframes are found by breadth-first search: each step leads to keyframes that share at
    least 15 points, to the parent or to the children in the spanning tree. The region is therefore
    the whole map if this has no more than `limit` keyframes.

    Args:
        atlas: The map.
        starts: Rows of the given keyframes.
        limit: Largest number of keyframes of the region.
    """
    parents = atlas.parents()
    order = np.argsort(parents, kind='stable')
    first = np.searchsorted(parents[order], np.arange(len(parents) + 1))
    known, chosen, border = set(starts.tolist()), list[int](), list[int]()
    waiting = starts.tolist()
    for i in waiting:  # grows meanwhile
        if len(chosen) == limit:
            border.append(i)
            continue
        chosen.append(i)
        near = [
            *atlas.covisible(i, NEAR_SHARED).tolist(),
            *order[first[i] : first[i + 1]].tolist(),
        ]
        if parents[i] >= 0:
            near.append(int(parents[i]))
        new = [n for n in near if n not in known]
        known.update(new)
        waiting += dict.fromkeys(new)
    return Region(np.sort(np.array(chosen, np.int64)), np.sort(np.array(border, np.int64)))
