"""When a tracked frame becomes a keyframe (ORB-SLAM2's rules for depth cameras)."""

from __future__ import annotations

import numpy as np

from rgbd_slam.config import KeyframeConfig
from rgbd_slam.keyframes import NO_POINT
from rgbd_slam.map import SlamMap
from rgbd_slam.tracker import Tracking

_MIN_INLIERS = 15
_WELL_OBSERVED = 3  # an observation with depth counts twice
_YOUNG_MAP = 2  # keyframes


def needs_keyframe(
    tracking: Tracking,
    slam_map: SlamMap,
    config: KeyframeConfig,
    close_limit_m: float,
    queue_length: int,
) -> bool:
    """Return whether the frame shows so much new that the map should take it in.

    A mapper with `queue_length` keyframes to do gets no further one; by the time it is done, what
    they add to the map is known, and often enough.
    """
    if queue_length > 0:
        return False
    frame, points = tracking.tracked.frame, tracking.tracked.points
    i = slam_map.keyframes.index_of(tracking.tracked.reference_uid)
    if i is None or tracking.num_inliers <= _MIN_INLIERS:
        return False
    close = (frame.depth_m > 0) & (frame.depth_m < close_limit_m)
    tracked_close = int(np.count_nonzero(close & (points != NO_POINT)))
    new_close = int(np.count_nonzero(close & (points == NO_POINT) & frame.may_seed))
    if tracked_close < config.min_close_tracked and new_close > config.min_close_new:
        return True
    seen = slam_map.keyframes.point_of_feature[i]
    seen = seen[seen != NO_POINT]
    weight = slam_map.points.num_observations[seen] + slam_map.points.num_stereo[seen]
    young = len(slam_map.keyframes) <= _YOUNG_MAP
    reference_points = np.count_nonzero(weight >= (2 if young else _WELL_OBSERVED))
    share = 0.4 if young else config.reference_share
    return bool(tracking.num_inliers < share * reference_points)
