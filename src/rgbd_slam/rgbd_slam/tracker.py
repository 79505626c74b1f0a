"""The pose of each frame: predict, match, optimise, then again with the local map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config import TrackingConfig
from rgbd_slam.frame import Frame, StereoCamera
from rgbd_slam.keyframes import NO_POINT
from rgbd_slam.local_map import LocalMap, local_map, visible_points
from rgbd_slam.map import SlamMap
from rgbd_slam.matching import (
    Matches,
    Queries,
    match_by_projection,
    rotation_consistent,
)
from rgbd_slam.point_tallies import PointTally
from rgbd_slam.pose_optimizer import PoseEstimate, PoseProblem, optimize_pose
from rgbd_slam.projection import project, to_camera
from rgbd_slam.tracked_frame import TrackedFrame, tracked_frame

_MIN_FIRST_INLIERS = 10  # of the frame-to-frame step; the local map must bring the rest


@dataclass(frozen=True, eq=False)
class Tracking:
    """What tracking one frame gave."""

    tracked: TrackedFrame
    estimate: PoseEstimate
    num_matches: int
    num_inliers: int
    tally: PointTally


class Tracker:
    """Tracks frames in a map that it does not change."""

    def __init__(self, camera: StereoCamera, slam_map: SlamMap, config: TrackingConfig) -> None:
        self._camera = camera
        self._map = slam_map
        self._config = config
        self._inv_sigma2 = slam_map.octave_scale**-2.0

    def track(
        self, frame: Frame, last: TrackedFrame, T_camera_last: FloatArray
    ) -> Tracking | None:
        """Return the frame's pose and points, or None when too little of the map is found.

        Args:
            frame: The frame.
            last: The frame before.
            T_camera_last: (4, 4) motion expected since.
        """
        T_last_map = se3.inverse(last.current_pose(self._map))
        first = self._from_last_frame(frame, last, T_camera_last @ T_last_map)
        if first is None:
            first = self._from_last_frame(frame, last, T_last_map)
        if first is None:
            return None
        estimate, points = first
        reference = self._map.keyframes.index_of(last.reference_uid)
        if reference is None:
            return None
        return self._from_local_map(frame, estimate, points, self._around(points, reference))

    def track_at(
        self, frame: Frame, T_camera_map: FloatArray, points: IntArray, reference: int
    ) -> Tracking | None:
        """Track a frame by what it was found to see, as when it was lost.

        Args:
            frame: The frame.
            T_camera_map: (4, 4) about where it is.
            points: (N,) point seen by each feature, or NO_POINT.
            reference: a keyframe that sees many of them.
        """
        estimate, points = self._optimize(frame, points, T_camera_map)
        return self._from_local_map(frame, estimate, points, self._around(points, reference))

    def _around(self, points: IntArray, reference: int) -> LocalMap:
        seen = points[points != NO_POINT]
        return local_map(self._map, seen, reference, self._config.max_local_keyframes)

    def _from_last_frame(
        self, frame: Frame, last: TrackedFrame, T_camera_map: FloatArray
    ) -> tuple[PoseEstimate, IntArray] | None:
        """Return a first pose from the points that the last frame saw."""
        config = self._config
        points = last.current_points(self._map)
        k_last = np.flatnonzero(points != NO_POINT)
        for radius_px in (config.last_frame_radius_px, config.wide_radius_px):
            matches = self._match_last(frame, last, k_last, points, T_camera_map, radius_px)
            if len(matches.q) >= config.few_matches:
                break
        found = np.full(len(frame), NO_POINT, np.int64)
        found[matches.k] = points[k_last[matches.q]]
        estimate, found = self._optimize(frame, found, T_camera_map)
        if np.count_nonzero(found != NO_POINT) < _MIN_FIRST_INLIERS:
            return None
        return estimate, found

    def _match_last(
        self,
        frame: Frame,
        last: TrackedFrame,
        k_last: IntArray,
        points: IntArray,
        T_camera_map: FloatArray,
        radius_px: float,
    ) -> Matches:
        table = self._map.points
        x = to_camera(T_camera_map, table.position_m[points[k_last]].T)
        behind = x[2] < 0.05
        x[2][behind] = 0.05
        pixels = np.empty_like(x)
        project(self._camera, x, pixels)
        pixels[:, behind] = -1e4
        octave = last.frame.octave[k_last].astype(np.int8)
        queries = Queries(
            pixels,
            radius_px * self._map.octave_scale[octave],
            octave - np.int8(1),
            octave + np.int8(1),
            table.descriptors[points[k_last]],
        )
        matches = match_by_projection(queries, frame, self._config.max_hamming, 1.0)
        consistent = rotation_consistent(
            last.frame.angle_deg[k_last[matches.q]], frame.angle_deg[matches.k]
        )
        return Matches(matches.q[consistent], matches.k[consistent], matches.distance[consistent])

    def _from_local_map(
        self,
        frame: Frame,
        estimate: PoseEstimate,
        points: IntArray,
        around: LocalMap,
    ) -> Tracking | None:
        """Find more points of the local map and refine the pose on all."""
        known = points[points != NO_POINT]
        others = np.setdiff1d(around.points, known, assume_unique=True)
        view = visible_points(
            self._map, self._camera, estimate.T_camera_map, others, self._config.local_map_radius
        )
        matches = match_by_projection(
            view.queries, frame, self._config.max_hamming, self._config.local_map_ratio,
            free=points == NO_POINT,
        )  # fmt: skip
        points = points.copy()
        points[matches.k] = view.points[matches.q]
        num_matches = int(np.count_nonzero(points != NO_POINT))
        estimate, points = self._optimize(frame, points, estimate.T_camera_map)
        found = points[points != NO_POINT]
        if len(found) < self._config.min_inliers:
            return None
        T_map_camera = se3.inverse(estimate.T_camera_map)
        tracked = tracked_frame(frame, T_map_camera, points, self._map, around.reference)
        tally = PointTally(np.concatenate([known, view.points]), found)
        return Tracking(tracked, estimate, num_matches, len(found), tally)

    def _optimize(
        self, frame: Frame, points: IntArray, T_camera_map: FloatArray
    ) -> tuple[PoseEstimate, IntArray]:
        """Return the pose that the matched points give, and the points without outliers."""
        k = np.flatnonzero(points != NO_POINT)
        problem = PoseProblem(
            self._map.points.position_m[points[k]],
            frame.measurement_px[k].astype(np.float64),
            self._inv_sigma2[frame.octave[k]],
        )
        estimate = optimize_pose(self._camera, problem, T_camera_map)
        kept = np.full(len(points), NO_POINT, np.int64)
        kept[k[estimate.inliers]] = points[k[estimate.inliers]]
        return estimate, kept
