"""Groups of keyframes: the nodes of the pose graph of a large map.

The time to optimize a pose graph grows with its nodes. Above `_MAX_NODES` keyframes, its nodes are
therefore one keyframe of each group, the head, and the corrections of the other keyframes are
interpolated. This is accurate, because a correction is spread over the whole loop.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray

# Chosen: largest number of nodes of the pose graph; above it, keyframes are grouped. Up to it, the
# optimization takes less time than moving the points.
_MAX_NODES = 500
_NEAR_M = 1e-6  # chosen: keeps the weight at the head itself finite, where the distance is 0
_TURN_M = 1.0  # chosen: a rotation of 1 rad from a head counts as much as this distance


class KeyframeGroups(NamedTuple):
    """N keyframes in G groups along the spanning tree; the pose graph holds the head of each."""

    heads: IntArray  # (G,) position of each group's head among the keyframes
    group: IntArray  # (N,) group of each keyframe


def keyframe_groups(parents: IntArray, *, is_grouped: bool = True) -> KeyframeGroups:
    """Group N keyframes along the spanning tree; up to 500 keyframes are groups of one.

    Args:
        parents: (N,) position of each keyframe's parent; -1 for a root.
        is_grouped: False: each keyframe is a group of one, however many there are.
    """
    n = len(parents)
    size = -(-n // _MAX_NODES)
    if size <= 1 or not is_grouped:
        return KeyframeGroups(np.arange(n), np.arange(n))
    children: list[list[int]] = [[] for _ in range(n)]
    for child, parent in enumerate(parents.tolist()):
        if parent >= 0:
            children[parent].append(child)
    group = np.full(n, -1, np.int64)
    heads: list[int] = []
    sizes: list[int] = []
    waiting = np.flatnonzero(parents < 0).tolist()
    while waiting:
        i = waiting.pop()
        of_parent = int(group[parents[i]]) if parents[i] >= 0 else -1
        if of_parent >= 0 and sizes[of_parent] < size:
            group[i] = of_parent
            sizes[of_parent] += 1
        else:
            group[i] = len(heads)
            heads.append(i)
            sizes.append(1)
        waiting += children[i]
    return KeyframeGroups(np.array(heads, np.int64), group)


def spread_corrections(
    groups: KeyframeGroups,
    T_map_camera: FloatArray,
    T_map_head: FloatArray,
    first: IntArray,
    second: IntArray,
) -> FloatArray:
    """Return the corrected poses (N, 4, 4) of all keyframes, given those of the heads.

    The correction of a keyframe is the mean of those of the heads of its own and neighboring
    groups, weighted by the inverse square of their distance (Shepard, ACM 1968).

    Args:
        T_map_camera: (N, 4, 4) poses of all keyframes before the correction.
        T_map_head: (G, 4, 4) corrected poses of the heads.
        first: (E,) one group of each pair of neighboring groups.
        second: (E,) the other group of each pair.
    """
    heads, group = groups
    if len(heads) == len(group):
        return T_map_head[np.argsort(heads)]
    correction = T_map_head @ se3.inverse(T_map_camera[heads])
    every = np.arange(len(heads))
    own, near = np.r_[every, first, second], np.r_[every, second, first]
    order = np.argsort(own, kind='stable')
    own, near = own[order], near[order]
    twist = se3.log(se3.inverse(correction[own]) @ correction[near])
    member, pair = _members_of_pairs(group, own)
    motion = se3.log(se3.inverse(T_map_camera[heads[near[pair]]]) @ T_map_camera[member])
    square = np.sum(motion[:, 3:] ** 2, axis=1) + _TURN_M**2 * np.sum(motion[:, :3] ** 2, axis=1)
    weight = 1 / (square + _NEAR_M**2)
    sums = [np.bincount(member, weight * column) for column in twist[pair].T]
    mean = np.stack(sums, axis=1) / np.bincount(member, weight)[:, None]
    corrected: FloatArray = correction[group] @ se3.exp(mean) @ T_map_camera
    return corrected


def _members_of_pairs(group: IntArray, own: IntArray) -> tuple[IntArray, IntArray]:
    """Return keyframes (M,) and pairs (M,): each keyframe with each pair of its group."""
    starts = np.searchsorted(own, group)
    counts = np.searchsorted(own, group, side='right') - starts
    member = np.repeat(np.arange(len(group)), counts)
    offset = np.arange(len(member)) - np.repeat(np.cumsum(counts) - counts, counts)
    return member, starts[member] + offset
