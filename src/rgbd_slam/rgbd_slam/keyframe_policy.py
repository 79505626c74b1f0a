"""When a tracked frame becomes a keyframe (after ORB-SLAM2's rules for depth cameras)."""

from __future__ import annotations

import numpy as np

from rgbd_slam.config import KeyframeConfig
from rgbd_slam.keyframes import NO_POINT
from rgbd_slam.map import SlamMap
from rgbd_slam.tracker import Tracking

_WELL_OBSERVED = 3  # an observation with depth counts twice
_YOUNG_MAP = 2  # keyframes
_YOUNG_SHARE = 0.4


class KeyframePolicy:
    """Judges frames by how much less they see of the map than those after the last keyframe."""

    def __init__(self, slam_map: SlamMap, config: KeyframeConfig, close_limit_m: float) -> None:
        self._map = slam_map
        self._config = config
        self._close_limit_m = close_limit_m
        self.inserted(0)

    def inserted(self, stamp_ns: int) -> None:
        """Take note of a keyframe."""
        self._last_ns = stamp_ns
        self._most_inliers = 0

    def wants(self, tracking: Tracking, queue_length: int) -> bool:
        """Return whether the frame shows so much new that the map should take it in.

        A mapper with `queue_length` keyframes to do gets no further one: what they add to the map
        may be enough. Nor does it soon after the last one, while tracking is good: many keyframes
        of one view only add noise.
        """
        num_inliers = tracking.num_inliers
        self._most_inliers = max(self._most_inliers, num_inliers)
        i = self._map.keyframes.index_of(tracking.tracked.reference_uid)
        if i is None or queue_length > 0:
            return False
        gap_s = 1e-9 * (tracking.tracked.frame.stamp_ns - self._last_ns)
        is_falling = num_inliers < self._config.fallen_share * self._most_inliers
        if gap_s < self._config.min_gap_s and not is_falling:
            return False
        return is_falling or self._lacks_depth(tracking) or self._leaves_reference(i, num_inliers)

    def _lacks_depth(self, tracking: Tracking) -> bool:
        """Return whether few close points are tracked and many could be made."""
        frame, points = tracking.tracked.frame, tracking.tracked.points
        close = (frame.depth_m > 0) & (frame.depth_m < self._close_limit_m)
        tracked = np.count_nonzero(close & (points != NO_POINT))
        new = np.count_nonzero(close & (points == NO_POINT) & frame.may_seed)
        return bool(tracked < self._config.min_close_tracked and new > self._config.min_close_new)

    def _leaves_reference(self, i: int, num_inliers: int) -> bool:
        """Return whether less is tracked than the reference keyframe sees for certain."""
        keyframes, points = self._map.keyframes, self._map.points
        seen = keyframes.point_of_feature[i]
        seen = seen[seen != NO_POINT]
        weight = points.num_observations[seen] + points.num_stereo[seen]
        young = len(keyframes) <= _YOUNG_MAP
        certain = np.count_nonzero(weight >= (2 if young else _WELL_OBSERVED))
        share = _YOUNG_SHARE if young else self._config.reference_share
        return bool(num_inliers < share * certain)
