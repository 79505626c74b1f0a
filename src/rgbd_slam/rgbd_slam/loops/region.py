"""The part of a map that a loop changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_tables import NEAR_SHARED


class Region(NamedTuple):
    """Connected keyframes of one map."""

    rows: IntArray  # (N,) ascending
    # (M,) ascending: keyframes outside that are connected with one inside; they keep their poses.
    border: IntArray


def region_around(atlas: Atlas, starts: IntArray, limit: int) -> Region:
    """Return the first `limit` keyframes of a breadth-first search from keyframes in rows (K,).

    Connected keyframes share at least 15 points, or are parent and child in the spanning tree.
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
