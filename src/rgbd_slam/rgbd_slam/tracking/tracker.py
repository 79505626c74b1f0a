"""The pose of each frame: predict, match, optimise, then again with the local map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, BoolArray, FloatArray, IntArray
from rgbd_slam.config.slam_config import TrackingConfig
from rgbd_slam.matching.landmarks import (
    Landmarks,
    Sightings,
    match_near,
    read_by_frame,
    seen_by_frame,
    seen_by_keyframe,
    turning_alike,
)
from rgbd_slam.matching.local_map import local_map, visible_points
from rgbd_slam.matching.matching import Matches, match_by_descriptor, match_by_projection
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.points import PointTally
from rgbd_slam.model.projection import MIN_DEPTH_M, to_camera
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_frame
from rgbd_slam.optimize.alignment import AlignmentStatus, align_image
from rgbd_slam.optimize.pose_consensus import Consensus, PoseConsensus
from rgbd_slam.optimize.pose_optimizer import PoseProblem

_MIN_FIRST_INLIERS = 10  # of the frame-to-frame step; the local map must bring the rest
_OUTSIDE_PX = -1e4


@dataclass(frozen=True, eq=False)
class TrackerOutput:
    """What tracking one frame gave."""

    tracked: TrackedFrame
    consensus: Consensus
    matched: IntArray  # (N,) point matched with each feature, or NO_POINT; outliers as well
    num_inliers: int  # of them
    tally: PointTally
    expected_px: FloatArray  # (3, V) where the local map has more points than the last frame saw
    moved: IntArray  # (M,) points of the map that turn out to be on what moves

    @property
    def num_matches(self) -> int:
        """Return how many features were matched with points of the map."""
        return int(np.count_nonzero(self.matched != NO_POINT))

    @property
    def is_outlier(self) -> BoolArray:
        """Return the (N,) mask of features whose match does not fit the pose."""
        return np.asarray((self.matched != NO_POINT) & (self.tracked.points == NO_POINT))

    @property
    def inlier_share(self) -> float:
        """Return the share of the matches that fit the pose; half of a false pose's do not."""
        return self.num_inliers / max(self.num_matches, 1)


class _First(NamedTuple):
    """A pose from few landmarks, to be refined with the local map."""

    consensus: Consensus
    seen: Sightings  # inliers


class Tracker:
    """Tracks frames in a map that it does not change.

    Args:
        camera: The camera, with the configured noise.
        atlas: The map.
        config: Parameters.
        seed: Of the samples tried where a frame is recognised; with its stamp.
    """

    def __init__(
        self, camera: StereoCamera, atlas: Atlas, config: TrackingConfig, seed: int = 0
    ) -> None:
        self._camera = camera
        self._atlas = atlas
        self._config = config
        self._seed = seed
        self._inv_sigma2 = atlas.octave_scale**-2.0

    def use_camera(self, camera: StereoCamera) -> None:
        """Weigh from now on with the noise measured meanwhile, of the same camera."""
        self._camera = camera

    def track(
        self, frame: Frame, last: TrackedFrame, *T_camera_last: FloatArray
    ) -> TrackerOutput | None:
        """Return the frame's pose and points, or None when too little of the map is found.

        Args:
            frame: The frame.
            last: The frame before.
            *T_camera_last: (4, 4) motions that are expected since, the likeliest first. They only
                say where to look: what most of the image fits is believed.
        """
        reference = self._atlas.keyframes.index_of(last.reference_uid)
        if reference is None:
            return None
        best = None
        for first in self._first_poses(frame, last, reference, T_camera_last):
            tracking = None if first is None else self._refine(frame, first, reference)
            if tracking is None:
                continue
            if self._is_convincing(tracking, last):
                return tracking
            if best is None or tracking.num_inliers > best.num_inliers:
                best = tracking
        return best

    def _is_convincing(self, tracking: TrackerOutput, last: TrackedFrame) -> bool:
        """Return whether most matches fit, or most of what the last frame saw is still seen."""
        share = self._config.convincing_share
        before = int(np.count_nonzero(last.points != NO_POINT))
        return tracking.inlier_share > share or tracking.num_inliers > share * before

    def track_at(
        self, frame: Frame, T_camera_map: FloatArray, points: IntArray, reference: int
    ) -> TrackerOutput | None:
        """Track a frame by what it was found to see, as when it was lost.

        Args:
            frame: The frame.
            T_camera_map: (4, 4) about where it is.
            points: (N,) point seen by each feature, or NO_POINT.
            reference: a keyframe that sees many of them.
        """
        k = np.flatnonzero(points != NO_POINT)
        seen = Sightings(k, points[k], self._atlas.points.position_m[points[k]])
        first = self._optimize(frame, seen, T_camera_map, is_first=True)
        return self._refine(frame, first, reference)

    def _first_poses(
        self,
        frame: Frame,
        last: TrackedFrame,
        reference: int,
        T_camera_last: Sequence[FloatArray],
    ) -> Iterator[_First | None]:
        """Yield first poses, found by ever more search; each is made when the last one failed.

        What the map knows comes first: depth readings of the last frame carry its error on.
        """
        config = self._config
        T_last_map = se3.inverse(last.current_pose(self._atlas))
        expected = [*(T @ T_last_map for T in T_camera_last), T_last_map]
        known = seen_by_frame(last, self._atlas)
        radii_px = config.last_frame_radius_px, config.wide_radius_px
        if len(known.point) >= config.few_points:
            for T_camera_map in expected:
                yield self._search(frame, known, T_camera_map, radii_px)
            yield self._recognize(frame, last, known, reference)
        more = known.joined(read_by_frame(last, self._atlas, self._camera))
        for T_camera_map in expected:
            yield self._search(frame, more, T_camera_map, radii_px)
        if len(known.point) < config.few_points:
            yield self._recognize(frame, last, known, reference)

    def _search(
        self,
        frame: Frame,
        landmarks: Landmarks,
        T_camera_map: FloatArray,
        radii_px: tuple[float, ...],
    ) -> _First | None:
        """Find landmarks around where a pose predicts them."""
        projection_px = self._project(landmarks, T_camera_map)
        scale = self._atlas.octave_scale[landmarks.octave]
        for radius_px in radii_px:
            matches = match_near(
                landmarks, frame, projection_px, radius_px * scale, self._config.max_hamming
            )
            if len(matches.q) >= self._config.few_matches:
                break
        return self._first(frame, landmarks, matches, T_camera_map)

    def _project(self, landmarks: Landmarks, T_camera_map: FloatArray) -> FloatArray:
        """Return (3, N) u, v, u_right; outside any image for what is behind the camera."""
        x = to_camera(T_camera_map, landmarks.position_m.T)
        behind = x[2] < MIN_DEPTH_M
        x[2][behind] = MIN_DEPTH_M
        pixels = self._camera.project_rows(x)
        pixels[:, behind] = _OUTSIDE_PX
        return pixels

    def _recognize(
        self, frame: Frame, last: TrackedFrame, known: Landmarks, reference: int
    ) -> _First | None:
        """Find by descriptors alone what the last frame and its reference keyframe saw."""
        config = self._config
        landmarks = seen_by_keyframe(self._atlas, reference)
        only_last = ~np.isin(known.point, landmarks.point)
        landmarks = landmarks.joined(known.select(only_last))
        matches = match_by_descriptor(
            landmarks.descriptors, frame, config.reference_max_hamming, config.reference_ratio
        )
        matches = turning_alike(landmarks, frame, matches)
        alignment = align_image(
            frame.measurement_px[matches.k],
            self._atlas.octave_scale[frame.octave[matches.k]],
            frame.depth_m[matches.k],
            landmarks.position_m[matches.q],
            self._camera,
            config.alignment,
            np.random.default_rng((self._seed, frame.stamp_ns % 2**63)),
        )
        T_camera_map = alignment.T_camera_points
        is_found = alignment.status is AlignmentStatus.OK
        if not (is_found and self._is_reachable(frame, last, T_camera_map)):
            return None
        agreeing = Matches(*(part[alignment.inliers] for part in matches))
        return self._first(frame, landmarks, agreeing, T_camera_map)

    def _is_reachable(self, frame: Frame, last: TrackedFrame, T_camera_map: FloatArray) -> bool:
        """Return whether a hand can have carried the camera there since the last frame."""
        elapsed_s = S_PER_NS * (frame.stamp_ns - last.frame.stamp_ns)
        step = se3.log(T_camera_map @ last.current_pose(self._atlas))
        turn, way = np.linalg.norm(step[:3]), np.linalg.norm(step[3:])
        config = self._config
        return bool(
            elapsed_s <= config.reference_within_s
            and turn < np.radians(config.jump_deg + config.max_turn_dps * elapsed_s)
            and way < config.jump_m + config.max_speed_mps * elapsed_s
        )

    def _first(
        self, frame: Frame, landmarks: Landmarks, matches: Matches, T_camera_map: FloatArray
    ) -> _First | None:
        seen = Sightings(matches.k, landmarks.point[matches.q], landmarks.position_m[matches.q])
        first = self._optimize(frame, seen, T_camera_map, is_first=True)
        return first if len(first.seen.k) >= _MIN_FIRST_INLIERS else None

    def _refine(self, frame: Frame, first: _First, reference: int) -> TrackerOutput | None:
        """Find more points of the local map and refine the pose on all."""
        known = first.seen.points
        around = local_map(self._atlas, known, reference, self._config.max_local_keyframes)
        is_known = np.zeros(self._atlas.points.capacity, np.bool_)
        is_known[known] = True
        others = around.points[~is_known[around.points]]
        view = visible_points(
            self._atlas,
            self._camera,
            first.consensus.estimate.T_camera_map,
            others,
            self._config.local_map_radius,
        )
        free = np.ones(len(frame), np.bool_)
        free[first.seen.k] = False
        matches = match_by_projection(
            view.queries, frame, self._config.max_hamming, self._config.local_map_ratio, free
        )
        j = view.points[matches.q]
        seen = first.seen.joined(Sightings(matches.k, j, self._atlas.points.position_m.take(j, 0)))
        consensus, fitting = self._optimize(frame, seen, first.consensus.estimate.T_camera_map)
        if len(fitting.k) < self._config.min_inliers:
            return None
        matched, points = np.full((2, len(frame)), NO_POINT, np.int64)
        matched[seen.k] = seen.point
        moved = np.empty(0, np.int64)
        if consensus.dragging is not None:
            region, moves = consensus.dragging
            drags = region.holds(self._camera, frame.measurement_px, frame.depth_m)
            moved = seen.point[moves & drags[seen.k] & (seen.point != NO_POINT)]
            fitting = fitting.select(~drags[fitting.k])
            frame = replace(frame, may_seed=frame.may_seed & ~drags)
        points[fitting.k] = fitting.point
        T_map_camera = se3.inverse(consensus.estimate.T_camera_map)
        tracked = tracked_frame(frame, T_map_camera, points, self._atlas, around.reference)
        found = fitting.points
        tally = PointTally(np.concatenate([known, view.points]), found)
        expected_px = view.queries.projection_px
        return TrackerOutput(tracked, consensus, matched, len(found), tally, expected_px, moved)

    def _optimize(
        self, frame: Frame, seen: Sightings, T_camera_map: FloatArray, *, is_first: bool = False
    ) -> _First:
        """Return the pose that the sightings give, and those that fit it."""
        problem = PoseProblem(
            seen.position_m,
            frame.measurement_px.take(seen.k, 0).astype(np.float64),
            self._inv_sigma2[frame.octave[seen.k]],
        )
        config = self._config.consensus
        num_observations = self._atlas.points.num_observations[seen.point]
        is_established = (seen.point != NO_POINT) & (num_observations >= config.min_observations)
        consensus = PoseConsensus(self._camera, config).solve(
            problem, is_established, T_camera_map, is_first=is_first
        )
        return _First(consensus, seen.select(consensus.estimate.inliers))
