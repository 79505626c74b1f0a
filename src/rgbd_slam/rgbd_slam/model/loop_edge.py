"""Loop edges: measured relative poses of keyframes at the same place, and their evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from hoid_common import se3
from hoid_common.values import FloatArray

JOIN = 'merged'
"""Kind of an edge that joined two maps."""


class LoopEdge(NamedTuple):
    """A loop or join that was found; the map may or may not use it."""

    first_uid: int  # the earlier keyframe, which was recognized
    second_uid: int  # the later keyframe, at which it was recognized
    T_first_second: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6) in the camera frame of the second keyframe, rotation first
    num_inliers: int  # number of matched points that agree with the edge
    found_share: float  # ratio of the expected points that were found
    kind: str  # effect on the map: the value of a `LoopEvent`, such as `JOIN`
    residual_m: float  # deviation of the map from the edge after optimization
    is_used: bool  # False: it was left out, because it contradicts the rest of the map

    def residual(self, T_map_first: FloatArray, T_map_second: FloatArray) -> FloatArray:
        """Return the motion (4, 4) by which the poses (4, 4) of both keyframes miss the edge."""
        T: FloatArray = se3.inverse(self.T_first_second) @ se3.inverse(T_map_first) @ T_map_second
        return T


def renumbered(edges: Iterable[LoopEdge], numbers: Mapping[int, int]) -> tuple[LoopEdge, ...]:
    """Return edges with new keyframe numbers, without edges whose keyframe has none."""
    return tuple(
        edge._replace(first_uid=numbers[edge.first_uid], second_uid=numbers[edge.second_uid])
        for edge in edges
        if edge.first_uid in numbers and edge.second_uid in numbers
    )


def moved_ends(
    edges: Iterable[LoopEdge], uid: int, parent_uid: int, T_parent_camera: FloatArray
) -> tuple[LoopEdge, ...]:
    """Return edges with a removed keyframe replaced by its parent; see `Redirect`.

    Edges that would connect a keyframe with itself are left out.
    """
    out = []
    for edge in edges:
        moved = edge
        if edge.first_uid == uid:
            moved = edge._replace(
                first_uid=parent_uid, T_first_second=T_parent_camera @ edge.T_first_second
            )
        elif edge.second_uid == uid:
            moved = edge._replace(
                second_uid=parent_uid,
                T_first_second=edge.T_first_second @ se3.inverse(T_parent_camera),
            )
        if moved.first_uid != moved.second_uid:
            out.append(moved)
    return tuple(out)
