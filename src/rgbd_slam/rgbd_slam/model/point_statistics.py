"""Viewing direction, scale range and descriptor of points, derived from their observations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from hoid_native import distinctive_descriptors
from hoid_native.results import Observations
from rgbd_slam.model.keyframes import KeyframeTable
from rgbd_slam.model.points import PointTable


class PointStatistics(NamedTuple):
    """Columns of points (P,) that are derived from their observations."""

    rows: IntArray  # (P,) ascending
    view_direction: FloatArray  # (P, 3) unit vectors from the cameras to the point, map frame
    reference_keyframe_uid: IntArray  # (P,)
    max_distance_m: Float32Array  # (P,)
    descriptors: ByteArray  # (P, 32)


def point_statistics(
    keyframes: KeyframeTable, points: PointTable, seen: Observations, octave_scale: FloatArray
) -> PointStatistics:
    """Return the statistics of all observed points, nearly as ORB-SLAM's MapPoint derives them.

    `max_distance_m` is the largest distance at which some octave can detect the point: its
    distance in the reference keyframe times the scale of the octave in which it was observed
    there. If the reference keyframe does not observe the point any more, the keyframe of its first
    observation in `seen` becomes the reference keyframe. The descriptor is one of the point's last
    eight observations in `seen`: the one with the least median distance to them.

    Args:
        keyframes: The keyframes.
        points: The points.
        seen: All observations of the points, at least one of each, sorted by point and keyframe.
        octave_scale: Scales of the octaves.
    """
    i, k, of = seen
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
        descriptors.take(distinctive_descriptors(descriptors, starts), 0),
    )


def _first_true(flags: np.ndarray[tuple[int], np.dtype[np.bool_]], starts: IntArray) -> IntArray:
    """Return the offset of the first True in each group, or 0 if a group has none."""
    lengths = np.diff(np.r_[starts, len(flags)])
    offset = np.arange(len(flags)) - np.repeat(starts, lengths)
    candidate = np.where(flags, offset, len(flags))
    first = np.minimum.reduceat(candidate, starts)
    return np.asarray(np.where(first == len(flags), 0, first))
