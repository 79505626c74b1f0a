"""When a tracked frame becomes a keyframe (after ORB-SLAM2's rules for depth cameras)."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, BoolArray, Float32Array, FloatArray, IntArray
from rgbd_slam.config.slam_config import KeyframeConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.tracking.tracker import TrackerOutput

_WELL_OBSERVED = 3  # an observation with depth counts twice
_YOUNG_MAP = 2  # keyframes
_YOUNG_SHARE = 0.4
_NEIGHBOURS = 24  # keyframes that may show the same as a frame
_SETTLED = 10  # keyframes since: what one sees is proven by others then, or culled
_SAME_VIEW = 0.2  # rad that one view is turned by, or would have to be to show as much else
_CELL_PX = 40  # where the map has a point, another is no news
_ROW = 1 << 16


class KeyframePolicy:
    """Judges frames by how much less they see of the map than those after the last keyframe.

    Args:
        atlas: The map.
        config: Parameters.
        close_px: Disparity from which on depth is trusted to make points.
    """

    def __init__(self, atlas: Atlas, config: KeyframeConfig, close_px: float) -> None:
        self._atlas = atlas
        self._config = config
        self._close_px = close_px
        self.restart()

    def reconfigure(self, config: KeyframeConfig) -> None:
        """Take over parameters that may change at run time."""
        self._config = config

    def restart(self) -> None:
        """Expect stamps that start anew: the last keyframe is long ago."""
        self.inserted(0)

    def inserted(self, stamp_ns: int) -> None:
        """Take note of a keyframe."""
        self._last_ns = stamp_ns
        self._most_inliers = 0

    def wants(self, tracking: TrackerOutput, queue_length: int) -> bool:
        """Return whether the frame shows so much new that the map should take it in.

        A mapper with `queue_length` keyframes to do gets no further one: what they add to the map
        may be enough. Nor does it soon after the last one, while tracking is good: many keyframes
        of one view only add noise.
        """
        num_inliers = tracking.num_inliers
        self._most_inliers = max(self._most_inliers, num_inliers)
        i = self._atlas.keyframes.index_of(tracking.tracked.reference_uid)
        if i is None or queue_length > 0:
            return False
        gap_s = S_PER_NS * (tracking.tracked.frame.stamp_ns - self._last_ns)
        share = num_inliers / max(self._most_inliers, 1)
        is_falling = share < self._config.fallen_share
        if gap_s < self._config.min_gap_s and not is_falling:
            return False
        if is_falling:
            return True  # a known view, too: it may be all that keeps tracking alive
        lacks = share < self._config.fewer_share or self._lacks_depth(tracking)
        lacks = lacks or self._leaves_reference(i, num_inliers)
        return lacks and not (self._config.skip_known_views and self._is_known_view(tracking, i))

    def _lacks_depth(self, tracking: TrackerOutput) -> bool:
        """Return whether few close points are tracked and many could be made."""
        frame, points = tracking.tracked.frame, tracking.tracked.points
        close = self._is_close(frame.measurement_px.T)
        tracked = np.count_nonzero(close & (points != NO_POINT))
        new = np.count_nonzero(close & (points == NO_POINT) & frame.may_seed)
        return bool(tracked < self._config.min_close_tracked and new > self._config.min_close_new)

    def _is_known_view(self, tracking: TrackerOutput, i: int) -> bool:
        """Return whether a settled keyframe shows the same, and nothing has appeared since.

        What is not tracked there was not found again either, and one more keyframe each time the
        camera comes by would make the map grow with time instead of with the space seen.
        """
        keyframes, frame = self._atlas.keyframes, tracking.tracked.frame
        rows = np.r_[i, self._atlas.covisible(i, limit=_NEIGHBOURS)]
        rows = rows[keyframes.uid[rows] <= keyframes.uid.max() - _SETTLED]
        T = se3.inverse(tracking.tracked.T_map_camera) @ keyframes.T_map_camera[rows]
        depth_m = np.median(frame.depth_m[frame.has_depth]) if frame.has_depth.any() else np.inf
        apart = np.linalg.norm(T[:, :3, 3], axis=1) / depth_m
        apart += np.linalg.norm(se3.log(T)[:, :3], axis=1)
        if not (apart < _SAME_VIEW).any():
            return False
        unknown = (tracking.tracked.points == NO_POINT) & frame.may_seed
        new_px = frame.measurement_px[unknown & self._is_close(frame.measurement_px.T)].T
        known_px = tracking.expected_px[:, self._is_close(tracking.expected_px)]
        appeared = np.count_nonzero(~np.isin(_cells(new_px), _cells(known_px)))
        return bool(appeared <= self._config.min_close_new)

    def _is_close(self, pixels: FloatArray | Float32Array) -> BoolArray:
        """Return the (N,) mask of (3, N) u, v, u_right near enough to make points of."""
        is_close: BoolArray = pixels[0] - pixels[2] > self._close_px  # NaN, no depth, is not
        return is_close

    def _leaves_reference(self, i: int, num_inliers: int) -> bool:
        """Return whether less is tracked than the reference keyframe sees for certain."""
        keyframes, points = self._atlas.keyframes, self._atlas.points
        seen = keyframes.point_of_feature[i]
        seen = seen[seen != NO_POINT]
        weight = points.num_observations[seen] + points.num_stereo[seen]
        young = len(keyframes) <= _YOUNG_MAP
        certain = np.count_nonzero(weight >= (2 if young else _WELL_OBSERVED))
        share = _YOUNG_SHARE if young else self._config.reference_share
        return bool(num_inliers < share * certain)


def _cells(pixels: FloatArray | Float32Array) -> IntArray:
    """Return (N,) numbers of the cells of the image that (3, N) u, v, u_right lie in."""
    u, v = (pixels[:2] // _CELL_PX).astype(np.int64)
    cells: IntArray = _ROW * v + u
    return cells
