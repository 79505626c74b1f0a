"""What is counted of a session's maps and events."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.trajectory import main_map


@dataclass(frozen=True)
class SlamStats:
    """Counts of the main map, that with most keyframes, and of events."""

    num_keyframes: int
    num_map_points: int
    num_maps: int = 0  # more than one only after a loss, until a known place joins them
    num_loops: int = 0
    num_merges: int = 0
    num_relocalizations: int = 0


def slam_stats(atlas: Atlas, loops: LoopCounts, num_relocalizations: int) -> SlamStats:
    """Count what the map holds now, beside what has happened to it."""
    keyframes, points = atlas.keyframes, atlas.points
    ids, main = keyframes.map_id[keyframes.alive], main_map(keyframes)
    return SlamStats(
        int(np.count_nonzero(ids == main)),
        int(np.count_nonzero(points.alive & (points.map_id == main))),
        len(np.unique(ids)),
        loops.closed,
        loops.merged,
        num_relocalizations,
    )
