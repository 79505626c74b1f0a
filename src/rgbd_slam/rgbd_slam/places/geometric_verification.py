"""Geometric verification: whether an image shows the place of a keyframe, and from which pose.

RANSAC over descriptor matches with the keyframe gives a pose. The points around the keyframe are
then searched where that pose predicts them (loop verification of ORB-SLAM2, Mur-Artal and Tardos,
T-RO 2017). In another place with identical furniture, many points are found, but more are missing,
because the walls differ. Therefore the found points must be a sufficient ratio of the expected
number, the sum of the points' detection probabilities. And depth measurements may lie behind only
few of the missing points. Points without features around them (masked people, blank walls) and
points behind an occluding object do not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.config.place_config import VerificationConfig
from rgbd_slam.config.slam_config import TrackingConfig
from rgbd_slam.matching.feature_grid import FeatureGrid
from rgbd_slam.matching.local_map import visible_points
from rgbd_slam.matching.matching import (
    Matches,
    match_by_descriptor,
    match_by_projection,
    rotation_consistent,
)
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera, to_camera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.points import PointTable
from rgbd_slam.optimize.alignment import align_image
from rgbd_slam.optimize.pose_optimizer import PoseEstimate, PoseProblem, covariance, optimize_pose

# Not tuned: factors on ORB-SLAM3's search windows, for the errors of a RANSAC pose in the first
# search, and of an optimized pose in the second.
_SEARCH_RADII = (4.0, 2.0)
# Chosen: after this many frames, the ratio of frames that find a point is known to 0.1.
_KNOWN_FRAMES = 10
_MIN_MATCHES = 10  # not tuned: with fewer matches, no pose is optimized
# Not tuned: half side of the window around a point in which features are compared, and least
# number of depths that contradict a point, because a single one may be wrong at a depth edge. A
# depth is behind or in front of a point if it differs by more than noise and the slope of surfaces
# explain: a constant part plus a ratio of the point's depth.
_WINDOW_PX = 12.0
_MIN_DEPTHS = 2
_DEPTH_TOLERANCE_M = 0.10
_DEPTH_TOLERANCE_SHARE = 0.12


class PlaceMatch(NamedTuple):
    """The verified pose of an image in the map of a keyframe."""

    T_camera_map: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6) in the camera frame, rotation first [rad^2, m^2]
    k: IntArray  # (M,) features of the image that fit the pose
    j: IntArray  # (M,) rows of the map points that they observe
    # Number of found points divided by the expected number (`PlaceEvidence`), at most 1; for a
    # loop with a large correction, of all compared views together.
    found_share: float = 0.0

    @property
    def T_map_camera(self) -> FloatArray:  # noqa: N802
        return se3.inverse(self.T_camera_map)

    @property
    def position_m(self) -> FloatArray:
        return self.T_map_camera[:3, 3]


class PlaceEvidence(NamedTuple):
    """How well an image agrees with the map points that are expected in it."""

    # Expected number: sum of the detection probabilities of the observable points.
    num_expected: float
    # Number of observable points that were found, divided by num_expected (at least by 1).
    found_share: float
    # Ratio of the points in view that were not found and are contradicted by all depths near them.
    contradicted_share: float
    # Number of observable points that at least 10 frames should have shown, each weighted by the
    # ratio of these frames that found it; and how many of these points were found. At the same
    # place, their ratio is 1, while `found_share` may exceed 1.
    num_known: float
    num_known_found: int

    def __str__(self) -> str:
        return (
            f'{100 * self.found_share:.0f} % of {self.num_expected:.0f} expected points found, '
            f'{100 * self.contradicted_share:.0f} % contradicted'
        )


class Visibility(NamedTuple):
    """Which of N points in view can be found in the image, and which contradict its depth."""

    # (N,) True: there are features near the point's pixel, and not all of their depths are in
    # front of the point, so that it is not occluded.
    observable: BoolArray
    # (N,) True: there are at least two depths near the point's pixel, and all are behind the
    # point.
    contradicted: BoolArray


class PlaceVerifier:
    """Verifies places in a map, without changing it."""

    def __init__(
        self, atlas: Atlas, camera: StereoCamera, config: VerificationConfig, seed: int
    ) -> None:
        self._atlas = atlas
        self._camera = camera
        self._config = config
        self._seed = seed
        self.doubt = ''  # why the last compared image does not show the place

    def verify(self, frame: Frame, candidate: int) -> PlaceMatch | None:
        """Return the pose of a frame if it shows the place of keyframe `candidate`, else None."""
        matches, seen = self._match_descriptors(frame, candidate)
        points_m = self._atlas.points.position_m[seen[matches.q]]
        rng = np.random.default_rng((self._seed, frame.stamp_ns % 2**63, candidate))
        scale = self._atlas.octave_scale
        alignment = align_image(frame, matches.k, points_m, scale, self._camera, rng)
        if alignment is None:
            self.doubt = f'too few matches: no pose fits 15 of {len(matches.k)} matching features'
            return None
        around = self._atlas.covisible(candidate, limit=self._config.neighbors)
        return self.search(frame, alignment.T_camera_points, np.r_[candidate, around])

    def search(
        self, frame: Frame, T_camera_map: FloatArray, keyframes: IntArray
    ) -> PlaceMatch | None:
        """Return a frame's pose near T_camera_map if it shows the points of keyframes (K,)."""
        points = self._atlas.points_of(keyframes)
        found = self._found(frame, T_camera_map, points)
        num_found = 0 if found is None else len(found.k)
        if found is None or num_found < self._config.min_inliers:
            self.doubt = f'geometry: {num_found} points of the map were found'
            return None
        evidence = self._evidence(frame, found.T_camera_map, found.j, points)
        is_same = evidence.found_share >= self._config.min_found_share
        is_same &= evidence.contradicted_share <= self._config.max_contradicted_share
        self.doubt = '' if is_same else f'geometry: {evidence}'
        return found._replace(found_share=min(evidence.found_share, 1.0)) if is_same else None

    def compare(
        self, frame: Frame, T_camera_map: FloatArray, keyframes: IntArray
    ) -> PlaceEvidence:
        """Return how well a frame near T_camera_map agrees with the points of keyframes (K,)."""
        points = self._atlas.points_of(keyframes)
        found = self._found(frame, T_camera_map, points)
        if found is None:
            return self._evidence(frame, T_camera_map, np.empty(0, np.int64), points)
        return self._evidence(frame, found.T_camera_map, found.j, points)

    def _found(
        self, frame: Frame, T_camera_map: FloatArray, points: IntArray
    ) -> PlaceMatch | None:
        """Search points (P,) in a frame twice; refine the pose after each search.

        In the second search, the windows are narrow, and descriptor distances may be as large as
        in tracking, because points look different from another side.
        """
        limits = self._config.max_hamming, TrackingConfig.max_hamming
        for radius, max_hamming in zip(_SEARCH_RADII, limits, strict=True):
            view = visible_points(self._atlas, self._camera, T_camera_map, points, radius)
            matches = match_by_projection(view.queries, frame, max_hamming, self._config.ratio)
            if len(matches.k) < _MIN_MATCHES:
                return None
            estimate = self._optimize(frame, matches.k, view.points[matches.q], T_camera_map)
            T_camera_map = estimate.T_camera_map
        return PlaceMatch(
            T_camera_map,
            covariance(estimate),
            matches.k[estimate.inliers],
            view.points[matches.q[estimate.inliers]],
        )

    def _evidence(
        self, frame: Frame, T_camera_map: FloatArray, found: IntArray, points: IntArray
    ) -> PlaceEvidence:
        """Compare the points (F,) found in a frame with all points (P,) expected in it."""
        table = self._atlas.points
        view = visible_points(self._atlas, self._camera, T_camera_map, points, 1.0)
        depth_m = to_camera(T_camera_map, table.position_m[view.points].T)[2]
        seen = visibility(view.queries.projection_px, depth_m, frame)
        is_found = np.isin(view.points, found)
        j, j_found = view.points[seen.observable], is_found[seen.observable]
        expected = float(detection_probability(table, j).sum())
        found_share = np.count_nonzero(j_found) / max(expected, 1.0)
        is_known = table.num_visible[j] >= _KNOWN_FRAMES
        known = table.num_found[j[is_known]] / table.num_visible[j[is_known]]
        num_contradicted = np.count_nonzero(seen.contradicted & ~is_found)
        contradicted_share = num_contradicted / max(len(view.points), 1)
        return PlaceEvidence(
            expected,
            found_share,
            contradicted_share,
            float(known.sum()),
            int(np.count_nonzero(j_found[is_known])),
        )

    def _match_descriptors(self, frame: Frame, candidate: int) -> tuple[Matches, IntArray]:
        """Match the O map points of a keyframe with the features of a frame, by descriptors.

        Return the matches, whose `q` are indices of the points, and the rows (O,) of the points.
        """
        keyframes, config = self._atlas.keyframes, self._config
        observing = np.flatnonzero(keyframes.point_of_feature[candidate] != NO_POINT)
        points = keyframes.point_of_feature[candidate, observing].astype(np.int64)
        descriptors = keyframes.descriptors[candidate, observing]
        matches = match_by_descriptor(descriptors, frame, config.max_hamming, config.ratio)
        consistent = rotation_consistent(
            keyframes.angle_deg[candidate, observing[matches.q]], frame.angle_deg[matches.k]
        )
        return matches.select(consistent), points

    def _optimize(
        self, frame: Frame, k: IntArray, j: IntArray, T_camera_map: FloatArray
    ) -> PoseEstimate:
        position_m = self._atlas.points.position_m[j]
        problem = PoseProblem.of(frame, k, position_m, self._atlas.octave_scale)
        return optimize_pose(self._camera, problem, T_camera_map)


def visibility(projection_px: FloatArray, depth_m: FloatArray, frame: Frame) -> Visibility:
    """Return which of N points are observable, and which contradict the depths near them.

    Args:
        projection_px: (3, N) predicted u, v, u_right of the points.
        depth_m: (N,) depths of the points in the camera frame.
    """
    n = len(depth_m)
    q, k = FeatureGrid(frame).search(projection_px[:2], np.full(n, _WINDOW_PX))
    features = np.bincount(q, minlength=n)
    has_depth = frame.depth_m[k] > 0
    q, k = q[has_depth], k[has_depth]
    difference_m = frame.depth_m[k] - depth_m[q]
    tolerance_m = _DEPTH_TOLERANCE_M + _DEPTH_TOLERANCE_SHARE * depth_m[q]
    num_depths = np.bincount(q, minlength=n)
    num_behind = np.bincount(q, difference_m > tolerance_m, minlength=n)
    num_in_front = np.bincount(q, difference_m < -tolerance_m, minlength=n)
    is_occluded = (num_depths > 0) & (num_in_front == num_depths)
    is_contradicted = (num_depths >= _MIN_DEPTHS) & (num_behind == num_depths)
    return Visibility((features > 0) & ~is_occluded, is_contradicted)


def detection_probability(points: PointTable, j: IntArray) -> FloatArray:
    """Return the probability (N,) that a frame finds each point (N,) in its view.

    It is the ratio of earlier frames that found it, smoothed by a Beta(1, 3) prior (chosen).
    """
    probability: FloatArray = (points.num_found[j] + 1.0) / (points.num_visible[j] + 4.0)
    return probability
