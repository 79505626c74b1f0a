"""Counts keyframes, points, maps, loops and relocalizations, and explains a state in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common.slam_status import SlamState
from rgbd_slam.loops.loop_closer import LoopCounts
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.trajectory import main_map
from rgbd_slam.tracking.tracking_result import TrackingResult

_MESSAGES = {
    SlamState.NOT_INITIALIZED: 'waiting for an image with enough static features that have depth',
    SlamState.TRACKING: '',
    SlamState.LOST: 'too few map points are seen; trying to recognize a mapped place',
    SlamState.PAUSED: 'paused; call ~/resume to continue',
}
_IN_OTHER_MAP = 'in a new map since the last loss; it is merged when a mapped place is recognized'
_TWO_MOTIONS = 'two motions explain this image: {:.0f} % / {:.0f} %; something large moves'


@dataclass(frozen=True)
class SlamStats:
    """The size of the main map (the one with most keyframes), and the numbers of maps and events.

    The events are those since the session started.
    """

    # Of the main map; before the first keyframe is inserted, the number of pending keyframes.
    num_keyframes: int
    num_map_points: int  # of the main map
    # More than one after a loss, or after a saved map was loaded beside the running one, until the
    # maps are merged.
    num_maps: int = 0
    num_loops: int = 0  # closed loops
    num_merges: int = 0  # merged maps
    num_relocalizations: int = 0


def slam_stats(atlas: Atlas, loops: LoopCounts, num_relocalizations: int) -> SlamStats:
    """Return the size of the main map, and the numbers of maps and events.

    Args:
        atlas: All maps.
        loops: The numbers of loops and merges so far.
        num_relocalizations: The number of relocalizations so far.
    """
    keyframes, points = atlas.keyframes, atlas.points
    sizes, main = np.bincount(keyframes.map_id[keyframes.alive]), main_map(keyframes)
    num_maps = int(np.count_nonzero(sizes))
    is_in_main = points.alive & (points.map_id == main) if num_maps > 1 else None
    return SlamStats(
        int(sizes[main]) if num_maps else len(atlas.pending),
        len(points) if is_in_main is None else int(np.count_nonzero(is_in_main)),
        num_maps,
        loops.closed,
        loops.merged,
        num_relocalizations,
    )


def status_message(state: SlamState, result: TrackingResult | None, is_in_main_map: bool) -> str:
    """Return a text that explains the state; '' for undisturbed tracking.

    Args:
        state: The state.
        result: The result of the latest image; None if no image has been tracked.
        is_in_main_map: Whether the camera is in the map with most keyframes.
    """
    if result is not None and result.note:
        return result.note
    if state is SlamState.TRACKING and not is_in_main_map:
        return _IN_OTHER_MAP
    if result is not None and result.competing is not None:
        competing = result.competing
        return _TWO_MOTIONS.format(100 * competing.chosen_share, 100 * competing.competing_share)
    return _MESSAGES[state]
