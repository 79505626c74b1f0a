"""The decision when a tracked frame becomes a keyframe (decision 004).

The rules extend those of ORB-SLAM2 for depth cameras (Mur-Artal and Tardos, T-RO 2017).
"""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, BoolArray, Float32Array, FloatArray, IntArray
from rgbd_slam.config.slam_config import KeyframeConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.optimize.measured_noise import median
from rgbd_slam.tracking.tracker import TrackerOutput

# Least number of observations of a confirmed point of the reference keyframe, where one with depth
# counts twice; the second number is for maps of at most two keyframes, for which ORB-SLAM3's ratio
# for a map of one keyframe replaces `reference_share` (ORB-SLAM3, Tracking.cc, NeedNewKeyFrame).
_MIN_WEIGHT = 3
_MIN_WEIGHT_NEW_MAP = 2
_NEW_MAP_KEYFRAMES = 2
_NEW_MAP_SHARE = 0.4
# Not tuned: number of covisible keyframes whose views are compared with that of a frame.
_NUM_NEIGHBORS = 24
# Decision 004: after this many further keyframes, the points of a keyframe are confirmed or
# culled.
_SETTLED_AGE = 10
# Decision 004: two views count as the same up to this difference: rotation (rad) plus distance
# divided by the median depth.
_SAME_VIEW_RAD = 0.2
# Difference of two views from which another keyframe is requested while one is pending. Chosen:
# the usual difference between two keyframes of a drive while the mapper is in time.
_PENDING_VIEW_RAD = 0.1
# Not tuned: side of the image cells (px). In a known view, a feature without a map point is new
# only if no map point is expected in its cell.
_CELL_PX = 40
_ROW = 1 << 16  # chosen: more than the number of cells in a row


class KeyframePolicy:
    """Selects a frame as a keyframe if it tracks clearly fewer map points than before.

    Its number of points is compared with the frames since the last keyframe, and with the
    reference keyframe. A frame that tracks few near points, but could create many, is selected
    too. Points are near if their disparity is above `close_px`.
    """

    def __init__(self, atlas: Atlas, config: KeyframeConfig, close_px: float) -> None:
        self._atlas = atlas
        self._config = config
        self._close_px = close_px
        self.restart()

    def reconfigure(self, config: KeyframeConfig) -> None:
        self._config = config

    def restart(self) -> None:
        """Forget the last keyframe, because the stamps have started anew."""
        self.inserted(0)

    def inserted(self, stamp_ns: int) -> None:
        """Register a keyframe with this stamp, with which later frames are compared."""
        self._last_ns = stamp_ns
        self._most_inliers = 0

    def wants(self, tracking: TrackerOutput) -> bool:
        """Return whether a frame should become a keyframe; call this for every tracked frame.

        While a keyframe is pending, only a change of the view counts. While tracking is good, no
        keyframe is requested within `min_gap_s` of the last one nor, with `skip_known_views`, in a
        view that an old keyframe has.
        """
        num_inliers = tracking.num_inliers
        self._most_inliers = max(self._most_inliers, num_inliers)
        if self._atlas.pending:
            return self._leaves_pending(tracking)
        anchor = self._atlas.anchor(tracking.tracked.reference_uid)
        if anchor is None or anchor.row is None:
            return False
        i = anchor.row
        gap_s = S_PER_NS * (tracking.tracked.frame.stamp_ns - self._last_ns)
        share = num_inliers / max(self._most_inliers, 1)
        is_falling = share < self._config.fallen_share
        if gap_s < self._config.min_gap_s and not is_falling:
            return False
        if is_falling:
            return True  # even in a known view, because the camera might get lost
        is_needed = share < self._config.fewer_share or self._lacks_close_points(tracking)
        is_needed = is_needed or self._leaves_reference(i, num_inliers)
        return is_needed and not (
            self._config.skip_known_views and self._is_known_view(tracking, i)
        )

    def _leaves_pending(self, tracking: TrackerOutput) -> bool:
        """Return whether the view has changed since the newest keyframe, which is still pending.

        A keyframe that overlaps with both views is needed then: without it, a late mapper could
        not connect the present view with the map.
        """
        T_map_pending = self._atlas.pose(max(self._atlas.pending))
        if T_map_pending is None:
            return False
        return bool(self._view_differences(tracking, T_map_pending[None])[0] > _PENDING_VIEW_RAD)

    def _lacks_close_points(self, tracking: TrackerOutput) -> bool:
        frame, points = tracking.tracked.frame, tracking.tracked.points
        close = self._is_close(frame.measurement_px.T)
        tracked = np.count_nonzero(close & (points != NO_POINT))
        new = np.count_nonzero(close & (points == NO_POINT) & frame.may_seed)
        return bool(tracked < self._config.min_close_tracked and new > self._config.min_close_new)

    def _is_known_view(self, tracking: TrackerOutput, i: int) -> bool:
        """Return whether an old keyframe has the same view, in which nothing is new.

        Features that do not match the map in a known view did not match it at earlier visits
        either. With a keyframe at each visit, the map would grow with time instead of with the
        mapped space.
        """
        keyframes, frame = self._atlas.keyframes, tracking.tracked.frame
        rows = np.r_[i, self._atlas.covisible(i, limit=_NUM_NEIGHBORS)]
        rows = rows[keyframes.uid[rows] <= keyframes.uid.max() - _SETTLED_AGE]
        difference_rad = self._view_differences(tracking, keyframes.T_map_camera[rows])
        if not (difference_rad < _SAME_VIEW_RAD).any():
            return False
        unknown = (tracking.tracked.points == NO_POINT) & frame.may_seed
        new_px = frame.measurement_px[unknown & self._is_close(frame.measurement_px.T)].T
        known_px = tracking.expected_px[:, self._is_close(tracking.expected_px)]
        appeared = np.count_nonzero(~np.isin(_cells(new_px), _cells(known_px)))
        return bool(appeared <= self._config.min_close_new)

    def _view_differences(self, tracking: TrackerOutput, poses: FloatArray) -> FloatArray:
        """Return the differences (N,) in rad between a frame's view and those at poses (N, 4, 4).

        A difference is the rotation plus the distance divided by the frame's median depth.
        """
        frame = tracking.tracked.frame
        T = se3.inverse(tracking.tracked.T_map_camera) @ poses
        depth_m = median(frame.depth_m[frame.has_depth]) if frame.has_depth.any() else np.inf
        difference_rad = np.linalg.norm(T[:, :3, 3], axis=1) / depth_m
        difference_rad += np.linalg.norm(se3.log(T)[:, :3], axis=1)
        return np.asarray(difference_rad)

    def _is_close(self, pixels: FloatArray | Float32Array) -> BoolArray:
        """Return the mask (N,) of u, v, u_right (3, N) that are near enough to create a point."""
        is_close: BoolArray = pixels[0] - pixels[2] > self._close_px  # False without depth (NaN)
        return is_close

    def _leaves_reference(self, i: int, num_inliers: int) -> bool:
        """Return whether a frame tracks few points compared with its reference keyframe `i`."""
        keyframes, points = self._atlas.keyframes, self._atlas.points
        seen = keyframes.point_of_feature[i]
        seen = seen[seen != NO_POINT]
        weight = points.num_observations[seen] + points.num_stereo[seen]
        in_map = keyframes.alive & (keyframes.map_id == keyframes.map_id[i])
        is_new_map = np.count_nonzero(in_map) <= _NEW_MAP_KEYFRAMES
        min_weight = _MIN_WEIGHT_NEW_MAP if is_new_map else _MIN_WEIGHT
        share = _NEW_MAP_SHARE if is_new_map else self._config.reference_share
        return bool(num_inliers < share * np.count_nonzero(weight >= min_weight))


def _cells(pixels: FloatArray | Float32Array) -> IntArray:
    u, v = (pixels[:2] // _CELL_PX).astype(np.int64)
    cells: IntArray = _ROW * v + u
    return cells
