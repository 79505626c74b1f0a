"""What follows from a point's observations: viewing direction, scale range, descriptor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from hoid_native import typical_descriptors
from rgbd_slam.model.keyframes import KeyframeTable, Observations
from rgbd_slam.model.points import PointTable


class PointStatistics(NamedTuple):
    """Columns of points (P,) that follow from their observations."""

    rows: IntArray  # (P,) ascending
    view_direction: FloatArray  # (P, 3) unit
    reference_keyframe_uid: IntArray  # (P,)
    max_distance_m: Float32Array  # (P,)
    descriptors: ByteArray  # (P, 32)


def point_statistics(
    keyframes: KeyframeTable, points: PointTable, seen: Observations, octave_scale: FloatArray
) -> PointStatistics:
    """Derive columns of points from all their observations, at least one (ORB-SLAM's MapPoint).

    The scale range is that in which an ORB octave can see the point: its distance in the reference
    keyframe times the scale of the octave it was seen in there, down to that of the finest octave.
    """
    order = np.argsort(seen.j, kind='stable')
    i, k, of = seen.i[order], seen.k[order], seen.j[order]
    ray = points.position_m.take(of, 0) - keyframes.T_map_camera[i, :3, 3]
    distance = np.linalg.norm(ray, axis=1)
    ray /= distance[:, None]
    starts = np.flatnonzero(np.r_[True, of[1:] != of[:-1]])
    rows = of[starts]
    mean = np.add.reduceat(ray, starts, axis=0)
    view_direction = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]

    is_reference = keyframes.uid[i] == points.reference_keyframe_uid[of]
    reference = starts + _first_true(is_reference, starts)
    octave = keyframes.octave[i[reference], k[reference]]
    scale = octave_scale[np.minimum(octave, len(octave_scale) - 1)]
    descriptors = keyframes.descriptors[i, k]
    return PointStatistics(
        rows,
        view_direction,
        keyframes.uid[i[reference]],
        (distance[reference] * scale).astype(np.float32),
        descriptors.take(typical_descriptors(descriptors, starts), 0),
    )


def _first_true(flags: np.ndarray[tuple[int], np.dtype[np.bool_]], starts: IntArray) -> IntArray:
    """Return per group the offset of its first True, 0 when it has none."""
    lengths = np.diff(np.r_[starts, len(flags)])
    offset = np.arange(len(flags)) - np.repeat(starts, lengths)
    candidate = np.where(flags, offset, len(flags))
    first = np.minimum.reduceat(candidate, starts)
    return np.asarray(np.where(first == len(flags), 0, first))
