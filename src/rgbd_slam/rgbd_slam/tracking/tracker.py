"""The pose of a frame: matched and optimized from a prediction, refined by the local map."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import S_PER_NS, BoolArray, FloatArray, IntArray
from rgbd_slam.config.slam_config import TrackingConfig
from rgbd_slam.matching.landmarks import (
    Correspondences,
    Landmarks,
    landmarks_of_frame,
    landmarks_of_keyframe,
    match_near_projections,
    temporal_landmarks,
    with_consistent_rotation,
)
from rgbd_slam.matching.local_map import find_local_map, visible_points
from rgbd_slam.matching.matching import Matches, match_by_descriptor, match_by_projection
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera, to_camera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.points import PointTally
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_frame
from rgbd_slam.optimize.alignment import align_image
from rgbd_slam.optimize.measured_noise import with_image_noise
from rgbd_slam.optimize.pose_consensus import Consensus, PoseConsensus
from rgbd_slam.optimize.pose_optimizer import PosePrior, PoseProblem

# With fewer inliers, the initial pose is rejected. The local map must contribute the rest of the
# inliers that a tracked frame needs (ORB-SLAM3, Tracking.cc, TrackWithMotionModel).
_MIN_INITIAL_INLIERS = 10
_OUTSIDE_PX = -1e4  # chosen: pixel that no search window of an image reaches


@dataclass(frozen=True, eq=False)
class TrackerOutput:
    """A tracked frame, and statistics for mapping and diagnostics."""

    tracked: TrackedFrame
    consensus: Consensus
    matched: IntArray  # (N,) point matched with each feature, or NO_POINT; outliers included
    tally: PointTally  # the points that should be visible in the frame, and those found in it
    # (3, V) u, v, u_right of the visible points of the local map, without the inliers of the
    # initial pose.
    expected_px: FloatArray
    moved: IntArray  # (M,) map points that turned out to be on moving objects
    # False: too few map points fit, and the pose depends on the last frame's depth.
    is_on_map: bool

    @property
    def num_inliers(self) -> int:
        return len(self.tally.found)

    @property
    def num_matches(self) -> int:
        return int(np.count_nonzero(self.matched != NO_POINT))

    @property
    def is_outlier(self) -> BoolArray:
        """Return the mask (N,) of features that do not observe the map point they match.

        Their match does not fit the pose, or is on an object that would bias the pose.
        """
        return np.asarray((self.matched != NO_POINT) & (self.tracked.points == NO_POINT))

    @property
    def inlier_ratio(self) -> float:
        return self.num_inliers / max(self.num_matches, 1)


class _FramePose(NamedTuple):
    """An estimated pose of a frame, with the correspondences that fit it."""

    consensus: Consensus
    inliers: Correspondences

    @property
    def T_camera_map(self) -> FloatArray:  # noqa: N802
        return self.consensus.estimate.T_camera_map


class _LocalMapMatches(NamedTuple):
    """The result of the search for the points of the local map in a frame."""

    reference_uid: int  # the keyframe that shares most points with the frame
    correspondences: Correspondences  # the inliers of the initial pose, then the new ones
    visible: IntArray  # (S,) points that should be visible, including those of the initial pose
    expected_px: FloatArray  # (3, V) projections of the points that were searched


class Tracker:
    """Estimates poses of frames in a map, without changing it.

    `seed` and a frame's stamp seed the random samples of RANSAC.
    """

    def __init__(
        self, camera: StereoCamera, atlas: Atlas, config: TrackingConfig, seed: int = 0
    ) -> None:
        self._camera = camera
        self._atlas = atlas
        self._config = config
        self._seed = seed
        self._consensus = PoseConsensus(camera, config.consensus)
        # Returns how many inliers a pose T_camera_map (4, 4) needs to be accepted.
        self.min_inliers: Callable[[FloatArray], int] = lambda _: config.min_inliers

    def use_camera(self, camera: StereoCamera) -> None:
        self._camera = self._consensus.camera = camera

    def track(
        self,
        frame: Frame,
        last: TrackedFrame,
        *T_camera_last: FloatArray,
        prior: PosePrior | None = None,
        corrected: Callable[[FloatArray], Frame] | None = None,
    ) -> TrackerOutput | None:
        """Return the tracked frame; None if no pose has enough inliers.

        Initial poses are tried from the cheapest to the most expensive search, and refined by the
        local map. The result is the first convincing pose, or else the one with most inliers. The
        predicted motions T_camera_last (4, 4), the most likely first, only place the search
        windows; the `prior` is used in the optimization together with the matches.
        `corrected` returns the frame, compensated for rolling shutter at the velocity of a motion
        T_last_camera (4, 4); it is called with that of each initial pose.
        """
        self._consensus.prior = prior
        if self._atlas.anchor(last.reference_uid) is None:
            return None
        best = None
        T_last_map = se3.inverse(last.current_pose(self._atlas))
        for initial in self._initial_poses(frame, last, T_camera_last):
            if initial is None:
                continue
            seen = frame
            if corrected is not None:
                seen = corrected(T_last_map @ se3.inverse(initial.T_camera_map))
            tracking = self._refine(seen, initial, last.reference_uid)
            if tracking is None:
                continue
            if self._is_convincing(tracking, last):
                return tracking
            if best is None or tracking.num_inliers > best.num_inliers:
                best = tracking
        return best

    def track_relocalized(
        self, frame: Frame, T_camera_map: FloatArray, points: IntArray, reference_uid: int
    ) -> TrackerOutput | None:
        """Track a relocalized frame from a pose and the points (N,) found; None if too few fit.

        `reference_uid` is the uid of a keyframe that observes many of these points.
        """
        self._consensus.prior = None
        k = np.flatnonzero(points != NO_POINT)
        found = Correspondences(k, points[k], self._atlas.points.position_m[points[k]])
        initial = self._estimate(frame, found, T_camera_map, is_initial=True)
        return self._refine(frame, initial, reference_uid)

    def _initial_poses(
        self, frame: Frame, last: TrackedFrame, T_camera_last: Sequence[FloatArray]
    ) -> Iterator[_FramePose | None]:
        """Yield initial poses, from the cheapest search to the most expensive; None: not found.

        If the last frame observed at least `few_points` map points, these are searched for before
        its depth measurements, which propagate the error of the last pose (decision 005).
        """
        config = self._config
        T_last_map = se3.inverse(last.current_pose(self._atlas))
        predicted = [*(T @ T_last_map for T in T_camera_last), T_last_map]
        known = landmarks_of_frame(last, self._atlas)
        radii_px = config.last_frame_radius_px, config.wide_radius_px
        if len(known.point) >= config.few_points:
            for T_camera_map in predicted:
                yield self._pose_by_prediction(frame, known, T_camera_map, radii_px)
            yield self._pose_by_descriptors(frame, last, known)
        more = known.joined(temporal_landmarks(last, self._atlas, self._camera))
        for T_camera_map in predicted:
            yield self._pose_by_prediction(frame, more, T_camera_map, radii_px)
        if len(known.point) < config.few_points:
            yield self._pose_by_descriptors(frame, last, known)

    def _pose_by_prediction(
        self,
        frame: Frame,
        landmarks: Landmarks,
        T_camera_map: FloatArray,
        radii_px: tuple[float, ...],
    ) -> _FramePose | None:
        """Return the pose from landmarks found near their predicted projections; None if few fit.

        `radii_px`, half sides of search windows, are tried until one gives `few_matches` matches.
        """
        projection_px = self._project(landmarks, T_camera_map)
        scale = self._atlas.octave_scale[landmarks.octave]
        for radius_px in radii_px:
            matches = match_near_projections(
                landmarks, frame, projection_px, radius_px * scale, self._config.max_hamming
            )
            if len(matches.q) >= self._config.few_matches:
                break
        return self._initial_pose(frame, landmarks, matches, T_camera_map)

    def _project(self, landmarks: Landmarks, T_camera_map: FloatArray) -> FloatArray:
        """Return u, v, u_right (3, N) in px of landmarks; far outside if behind the camera."""
        x = to_camera(T_camera_map, landmarks.position_m.T)
        is_behind = x[2] < MIN_DEPTH_M
        x[2][is_behind] = MIN_DEPTH_M
        pixels = self._camera.project_rows(x)
        pixels[:, is_behind] = _OUTSIDE_PX
        return pixels

    def _pose_by_descriptors(
        self, frame: Frame, last: TrackedFrame, known: Landmarks
    ) -> _FramePose | None:
        """Return the pose from descriptor matches with the last frame and its reference keyframe.

        It needs no prediction, but is rejected if the camera cannot have moved that far.
        """
        config, anchor = self._config, self._atlas.anchor(last.reference_uid)
        if anchor is None or anchor.row is None:
            return None
        landmarks = landmarks_of_keyframe(self._atlas, anchor.row)
        is_only_in_last = ~np.isin(known.point, landmarks.point)
        landmarks = landmarks.joined(known.select(is_only_in_last))
        matches = match_by_descriptor(
            landmarks.descriptors, frame, config.reference_max_hamming, config.reference_ratio
        )
        matches = with_consistent_rotation(landmarks, frame, matches)
        points_m, scale = landmarks.position_m[matches.q], self._atlas.octave_scale
        rng = np.random.default_rng((self._seed, frame.stamp_ns % 2**63))
        alignment = align_image(frame, matches.k, points_m, scale, self._camera, rng)
        if alignment is None:
            return None
        T_camera_map = alignment.T_camera_points
        if not self._is_reachable(frame, last, T_camera_map):
            return None
        inliers = matches.select(alignment.inliers)
        return self._initial_pose(frame, landmarks, inliers, T_camera_map)

    def _is_reachable(self, frame: Frame, last: TrackedFrame, T_camera_map: FloatArray) -> bool:
        """Return whether the camera can have moved to a pose since a recent last frame."""
        elapsed_s = S_PER_NS * (frame.stamp_ns - last.frame.stamp_ns)
        twist = se3.log(T_camera_map @ last.current_pose(self._atlas))
        turn_rad, distance_m = np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])
        config = self._config
        return bool(
            elapsed_s <= config.reference_within_s
            and turn_rad < np.radians(config.jump_deg + config.max_turn_dps * elapsed_s)
            and distance_m < config.jump_m + config.max_speed_mps * elapsed_s
        )

    def _initial_pose(
        self, frame: Frame, landmarks: Landmarks, matches: Matches, T_camera_map: FloatArray
    ) -> _FramePose | None:
        found = landmarks.matched(matches)
        initial = self._estimate(frame, found, T_camera_map, is_initial=True)
        return initial if len(initial.inliers.k) >= _MIN_INITIAL_INLIERS else None

    def _estimate(
        self,
        frame: Frame,
        found: Correspondences,
        T_camera_map: FloatArray,
        *,
        is_initial: bool = False,
    ) -> _FramePose:
        """Optimize a pose on correspondences; return it with its inliers."""
        problem = PoseProblem.of(frame, found.k, found.position_m, self._atlas.octave_scale)
        if not is_initial:
            problem = with_image_noise(self._camera, problem, T_camera_map)
        num_observations = self._atlas.points.num_observations[found.point]
        is_in_map = found.point != NO_POINT
        min_observations = self._config.consensus.min_observations
        is_well_observed = is_in_map & (num_observations >= min_observations)
        consensus = self._consensus.solve(
            problem, is_well_observed, T_camera_map, is_initial=is_initial
        )
        return _FramePose(consensus, found.select(consensus.estimate.inliers))

    def _refine(
        self, frame: Frame, initial: _FramePose, reference_uid: int
    ) -> TrackerOutput | None:
        """Return the frame with its pose refined by the local map; None if too few points fit."""
        searched = self._match_local_map(frame, initial, reference_uid)
        refined = self._estimate(frame, searched.correspondences, initial.T_camera_map)
        if not self._atlas.guard.is_valid(refined.T_camera_map, 'images'):
            return None
        if len(refined.inliers.k) < self.min_inliers(refined.T_camera_map):
            return None
        return self._output(frame, searched, refined)

    def _match_local_map(
        self, frame: Frame, initial: _FramePose, reference_uid: int
    ) -> _LocalMapMatches:
        """Match the local map as projected by an initial pose; keep the inliers of that pose."""
        known = initial.inliers.points
        local_map = find_local_map(
            self._atlas, known, reference_uid, self._config.max_local_keyframes
        )
        is_known = np.zeros(self._atlas.points.capacity, np.bool_)
        is_known[known] = True
        view = visible_points(
            self._atlas,
            self._camera,
            initial.T_camera_map,
            local_map.points[~is_known[local_map.points]],
            self._config.local_map_radius,
        )
        is_free = np.ones(len(frame), np.bool_)
        is_free[initial.inliers.k] = False
        matches = match_by_projection(
            view.queries, frame, self._config.max_hamming, self._config.local_map_ratio, is_free
        )
        j = view.points[matches.q]
        new = Correspondences(matches.k, j, self._atlas.points.position_m.take(j, 0))
        return _LocalMapMatches(
            local_map.reference_uid,
            initial.inliers.joined(new),
            np.concatenate([known, view.points]),
            view.queries.projection_px,
        )

    def _output(
        self, frame: Frame, searched: _LocalMapMatches, refined: _FramePose
    ) -> TrackerOutput:
        """Return the tracked frame, without observations on an object that biases the pose.

        Features on such an object are still in `matched`, but observe and create no map point.
        """
        found = searched.correspondences
        consensus = refined.consensus
        inliers = refined.inliers
        moved = np.empty(0, np.int64)
        if consensus.biasing is not None:
            region, prefers_its_motion = consensus.biasing
            is_on_it = region.contains(self._camera, frame.measurement_px, frame.depth_m)
            is_moving = prefers_its_motion & is_on_it[found.k] & (found.point != NO_POINT)
            moved = found.point[is_moving]
            inliers = inliers.select(~is_on_it[inliers.k])
            frame = replace(frame, may_seed=frame.may_seed & ~is_on_it)
        matched, points = np.full((2, len(frame)), NO_POINT, np.int64)
        matched[found.k] = found.point
        points[inliers.k] = inliers.point
        T_map_camera = se3.inverse(refined.T_camera_map)
        tally = PointTally(searched.visible, inliers.points)
        is_on_map = len(tally.found) >= self._config.min_inliers
        pending = self._atlas.pending
        # If the mapper is late and the map does not show the view, a pending keyframe does.
        reference_uid = searched.reference_uid if is_on_map or not pending else max(pending)
        return TrackerOutput(
            tracked_frame(frame, T_map_camera, points, self._atlas, reference_uid),
            consensus,
            matched,
            tally,
            searched.expected_px,
            moved,
            is_on_map,
        )

    def _is_convincing(self, tracking: TrackerOutput, last: TrackedFrame) -> bool:
        """Return whether most matches fit, or most points of the last frame are found again."""
        share = self._config.convincing_share
        num_last = int(np.count_nonzero(last.points != NO_POINT))
        return tracking.inlier_ratio > share or tracking.num_inliers > share * num_last
