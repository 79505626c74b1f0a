"""Changes of a map: changed rows, which copies need, and removed and pending keyframes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.records.soa_table import SoaTableRows

# Number of removed keyframes whose redirects are kept. Chosen: more than can be removed while a
# request to the mapper waits in the queue.
_MAX_REMEMBERED = 4096


class Redirect(NamedTuple):
    """A keyframe that is not in the map, with the parent that replaces it as a reference.

    It was removed, or is pending: requested by the tracker, but not inserted by the mapper yet.
    """

    uid: int
    parent_uid: int  # may also be removed or pending; DEAD for the first keyframe of a map
    # (4, 4), orthonormalized because redirects are chained; T_map_camera if there is no parent.
    T_parent_camera: FloatArray


class Connections(NamedTuple):
    """The neighbors of R keyframes: the keyframes with which each shares points."""

    rows: IntArray  # (R,) rows of the keyframes
    lengths: IntArray  # (R,) numbers of neighbors
    neighbors: IntArray  # (sum of lengths,) rows of the neighbors, keyframe by keyframe
    shared: IntArray  # (sum of lengths,) number of points shared with each neighbor


class FeatureStates(NamedTuple):
    """The states of N features of keyframes: keyframe i observes point j in its feature k."""

    i: NDArray[np.int32]
    k: NDArray[np.int32]
    j: NDArray[np.int32]  # NO_POINT: the feature observes no point
    may_seed: NDArray[np.bool_]  # whether the feature may create a point


class PointPositions(NamedTuple):
    """The positions of N points."""

    rows: NDArray[np.int32]  # (N,) rows of the points
    position_m: FloatArray  # (N, 3) in the frame of their map


class Move(NamedTuple):
    """A rigid motion of each of N keyframes, with which their points move."""

    uids: IntArray  # (N,)
    T_new_old: FloatArray  # (N, 4, 4) in the map frame
    map_id: int | None = None  # the map to which they belong now; None: unchanged


class MapChange(NamedTuple):
    """The difference between two versions of a map, to be applied to a copy of the older one."""

    version: int
    moves: tuple[Move, ...]  # to be applied first, in this order
    keyframes: SoaTableRows
    points: SoaTableRows
    positions: PointPositions  # positions of points with no other changes
    observations: FeatureStates  # states of features that have changed
    connections: Connections  # of keyframes whose shared points were counted again
    redirects: tuple[Redirect, ...]
    num_refused: int  # number of poses that the `PoseGuard` has refused since the last change
    loops: tuple[LoopEdge, ...] | None  # all loop edges; None: they have not changed


class Redirects:
    """The redirects of a map: `take` returns each once, `find` one of the latest 4096 by uid."""

    def __init__(self) -> None:
        self._to_take: list[Redirect] = []
        self._removed: dict[int, Redirect] = {}  # by uid, oldest first

    def clear(self) -> None:
        self._to_take = []
        self._removed.clear()

    def add(self, redirects: Iterable[Redirect]) -> None:
        for redirect in redirects:
            self._to_take.append(redirect)
            self._removed[redirect.uid] = redirect
            if len(self._removed) > _MAX_REMEMBERED:
                del self._removed[next(iter(self._removed))]

    def take(self) -> tuple[Redirect, ...]:
        """Return the redirects that were added since the last call."""
        redirects, self._to_take = tuple(self._to_take), []
        return redirects

    def find(self, uid: int) -> Redirect | None:
        """Return a keyframe's redirect; None if it is not one of the latest 4096 redirects."""
        return self._removed.get(uid)
