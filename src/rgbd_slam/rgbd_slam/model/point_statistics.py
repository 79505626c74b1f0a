"""What follows from a point's observations: viewing direction, scale range, descriptor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hoid_common.values import ByteArray, IntArray

if TYPE_CHECKING:
    from rgbd_slam.model.atlas import Atlas

_MAX_COMPARED = 8  # observations whose descriptors are compared; more change the median little


def refresh_points(atlas: Atlas, j: IntArray) -> None:
    """Derive the columns of live points `j` from their observations (ORB-SLAM's MapPoint rules).

    The scale range is that in which an ORB octave can see the point: its distance in the reference
    keyframe times the scale of the octave it was seen in there, down to that of the finest octave.
    """
    kf, points = atlas.keyframes, atlas.points
    j = j[points.uid[j] >= 0]
    seen = atlas.observations_of(j)
    if len(seen.j) == 0:
        return
    order = np.argsort(seen.j, kind='stable')
    i, k, of = seen.i[order], seen.k[order], seen.j[order]
    ray = points.position_m[of] - kf.T_map_camera[i, :3, 3]
    distance = np.linalg.norm(ray, axis=1)
    ray /= distance[:, None]
    starts = np.flatnonzero(np.r_[True, of[1:] != of[:-1]])
    rows = of[starts]
    mean = np.add.reduceat(ray, starts, axis=0)
    points.view_direction[rows] = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]

    is_reference = kf.uid[i] == points.reference_keyframe_uid[of]
    reference = starts + _first_true(is_reference, starts)
    points.reference_keyframe_uid[rows] = kf.uid[i[reference]]
    scale = atlas.octave_scale
    octave = np.minimum(kf.octave[i[reference], k[reference]], len(scale) - 1)
    points.max_distance_m[rows] = distance[reference] * scale[octave]
    points.min_distance_m[rows] = points.max_distance_m[rows] / scale[-1]
    points.descriptors[rows] = typical_descriptors(kf.descriptors[i, k], starts)
    points.version[rows] = atlas.version


def _first_true(flags: np.ndarray[tuple[int], np.dtype[np.bool_]], starts: IntArray) -> IntArray:
    """Return per group the offset of its first True, 0 when it has none."""
    lengths = np.diff(np.r_[starts, len(flags)])
    offset = np.arange(len(flags)) - np.repeat(starts, lengths)
    candidate = np.where(flags, offset, len(flags))
    first = np.minimum.reduceat(candidate, starts)
    return np.asarray(np.where(first == len(flags), 0, first))


def typical_descriptors(descriptors: ByteArray, starts: IntArray) -> ByteArray:
    """Return per group the (32,) descriptor with the least median Hamming distance to the others.

    Args:
        descriptors: (M, 32), grouped.
        starts: (G,) first row of each group, ascending; only a group's last rows are compared when
            it is large.
    """
    ends = np.r_[starts[1:], len(descriptors)]
    out: ByteArray = descriptors[ends - 1].copy()
    size = np.minimum(ends - starts, _MAX_COMPARED)
    words = np.ascontiguousarray(descriptors).view(np.uint64)
    for n in range(3, _MAX_COMPARED + 1):  # with two, both are as typical: the newest is kept
        groups = np.flatnonzero(size == n)
        if len(groups) == 0:
            continue
        rows = ends[groups, None] - n + np.arange(n)
        block = words[rows]
        apart = np.bitwise_count(block[:, :, None] ^ block[:, None]).sum(-1, dtype=np.uint16)
        best = np.argmin(np.median(apart, axis=2), axis=1)
        out[groups] = descriptors[rows[np.arange(len(groups)), best]]
    return out
