"""Optimizes the pose graph of a map, leaving out loops that contradict the others.

As in RTAB-Map (RGBD/OptimizeMaxError), a loop is left out if the optimized map deviates from it by
more than the error of a measured loop: either this loop or one of the others is wrong then.
"""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray
from rgbd_slam.loops.essential_graph import closed_poses
from rgbd_slam.loops.loop_detection import motion_size
from rgbd_slam.loops.region import Region
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge

# Chosen: largest deviation of the optimized map from a loop. Loops between the same places deviate
# by some centimeters; places that look alike are at least 2 m apart.
_MAX_DEVIATION = np.deg2rad(5.0), 0.25  # [rad], [m]

_logger = logging.getLogger(__name__)


class OptimizedGraph(NamedTuple):
    """The result of `optimized`."""

    T_map_camera: FloatArray  # (N, 4, 4) of the region's keyframes
    # All loops of the map, with their residuals; those left out have `is_used` set to False.
    loops: tuple[LoopEdge, ...]


def optimized(atlas: Atlas, region: Region, min_shared: int) -> OptimizedGraph:
    """Return the optimized poses of a region; the map itself is not changed.

    If the optimized poses deviate from a loop by more than 0.25 m or 5 degrees, the loop with the
    largest deviation is left out (the newest of several), and the graph is optimized again.

    Args:
        atlas: The map, whose last loop is the new one.
        region: The keyframes whose poses are corrected.
        min_shared: Number of shared points from which two keyframes are connected by an edge.
    """
    loops = list(atlas.loops)
    while True:
        T_map_camera = closed_poses(atlas, region, loops, min_shared)
        poses = atlas.keyframes.T_map_camera.copy()
        poses[region.rows] = T_map_camera
        deviations = np.array([_deviation(atlas, edge, poses) for edge in loops])
        loops = [
            e._replace(residual_m=m) for e, m in zip(loops, deviations[:, 1].tolist(), strict=True)
        ]
        excess = (deviations / _MAX_DEVIATION).max(1) * [edge.is_used for edge in loops]
        worst = int(len(excess) - 1 - np.argmax(excess[::-1]))
        if excess[worst] <= 1.0:
            return OptimizedGraph(T_map_camera, tuple(loops))
        text = 'loop %d is left out: the rest of the map contradicts it by %.2f m'
        _logger.warning(text, worst, loops[worst].residual_m)
        loops[worst] = loops[worst]._replace(is_used=False)


def _deviation(atlas: Atlas, edge: LoopEdge, poses: FloatArray) -> tuple[float, float]:
    """Return the angle [rad] and distance [m] by which poses (capacity, 4, 4) deviate from a loop.

    They are 0 if the loop is between different maps.
    """
    ends = atlas.keyframes.ends_of(edge)
    return (0.0, 0.0) if ends is None else motion_size(edge.residual(*poses[list(ends)]))
