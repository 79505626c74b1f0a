"""What is counted of a session's maps and events, and said of its state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common.slam_status import SlamState
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.trajectory import main_map
from rgbd_slam.tracking.tracking_result import TrackingResult

_MESSAGES = {
    SlamState.NOT_INITIALIZED: 'waiting for an image with enough static features that have depth',
    SlamState.TRACKING: '',
    SlamState.LOST: 'too few map points are seen; looking for a known place',
    SlamState.PAUSED: 'paused; ~/resume goes on',
}
_IN_OTHER_MAP = 'in a new map since the last loss; a known place will join the two'
_TWO_MOTIONS = 'two motions explain this image: {:.0f} % / {:.0f} %; something large moves'


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
        int(np.count_nonzero(np.bincount(ids))),
        loops.closed,
        loops.merged,
        num_relocalizations,
    )


def status_message(state: SlamState, result: TrackingResult | None, is_in_main_map: bool) -> str:
    """Return why the state is what it is, in plain words; empty when there is nothing to say."""
    if result is not None and result.note:
        return result.note
    if state is SlamState.TRACKING and not is_in_main_map:
        return _IN_OTHER_MAP
    if result is not None and result.rival is not None:
        rival = result.rival
        return _TWO_MOTIONS.format(100 * rival.chosen_share, 100 * rival.rival_share)
    return _MESSAGES[state]
