"""Whether an image shows the place that a keyframe shows, and from where.

Descriptors propose, geometry decides: RANSAC over the feature matches with the keyframe gives a
pose, points of its neighbourhood are then searched where that pose predicts them (ORB-SLAM's loop
verification, Mur-Artal and Tardos, T-RO 2017), and at last enough of what should be there must
have been found, and depth must not look through it.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.place_config import VerificationConfig
from rgbd_slam.matching.local_map import VisiblePoints, visible_points
from rgbd_slam.matching.matching import (
    Matches,
    best_matches,
    match_by_projection,
    rotation_consistent,
)
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.projection import to_camera
from rgbd_slam.optimize.alignment import AlignmentStatus, align_image
from rgbd_slam.optimize.pose_optimizer import PoseEstimate, PoseProblem, optimize_pose
from rgbd_slam.places.visibility import chance_found, visibility

_GUIDED_RADII = (4.0, 2.0)  # first as far as RANSAC's pose may be off, then close
_MIN_GUIDED = 10  # matches that an optimisation is worth


class PlaceStatus(Enum):
    """How a verification ended."""

    SAME_PLACE = 'same place'
    NO_ALIGNMENT = 'no alignment'
    TOO_FEW_FOUND = 'too few found'
    CONTRADICTED = 'contradicted'


class PlaceMatch(NamedTuple):
    """The pose of an image in the map of a keyframe, and what supports it."""

    status: PlaceStatus
    T_camera_map: FloatArray  # (4, 4); identity without an alignment
    k: IntArray  # (M,) features of the image
    j: IntArray  # (M,) points that they see
    found_share: float = 0.0  # of the points that should have been found there
    contradicted_share: float = 0.0  # of the points in view, those that depth looks through

    @property
    def pose(self) -> FloatArray:
        """Return T_map_camera, (4, 4)."""
        return se3.inverse(self.T_camera_map)

    @property
    def position_m(self) -> FloatArray:
        """Return (3,) where the camera is in the map."""
        return self.pose[:3, 3]


class PlaceVerifier:
    """Verifies places against a map that it does not change."""

    def __init__(
        self, atlas: Atlas, camera: StereoCamera, config: VerificationConfig, seed: int
    ) -> None:
        self._atlas = atlas
        self._camera = camera
        self._config = config
        self._seed = seed

    def verify(self, frame: Frame, candidate: int) -> PlaceMatch:
        """Look for what keyframe `candidate` and its neighbours see in a frame."""
        matches, seen = self._feature_matches(frame, candidate)
        points = self._atlas.points.position_m[seen]
        rng = np.random.default_rng((self._seed, frame.stamp_ns % 2**63, candidate))
        alignment = align_image(
            frame.measurement_px[matches.k],
            self._atlas.octave_scale[frame.octave[matches.k]],
            frame.depth_m[matches.k],
            points[matches.q],
            self._camera,
            self._config.alignment,
            rng,
        )
        if alignment.status is not AlignmentStatus.OK:
            nothing = np.empty(0, np.int64)
            return PlaceMatch(PlaceStatus.NO_ALIGNMENT, np.eye(4), nothing, nothing)
        around = self._atlas.covisible(candidate, limit=self._config.neighbours)
        return self.search(frame, alignment.T_camera_points, np.r_[candidate, around])

    def search(self, frame: Frame, T_camera_map: FloatArray, keyframes: IntArray) -> PlaceMatch:
        """Search the points of keyframes where a pose predicts them, and judge what is found."""
        seen = np.unique(self._atlas.keyframes.point_of_feature[keyframes])
        points = seen[seen != NO_POINT].astype(np.int64)
        k = j = np.empty(0, np.int64)
        for radius in _GUIDED_RADII:
            view = visible_points(self._atlas, self._camera, T_camera_map, points, radius)
            matches = match_by_projection(
                view.queries, frame, self._config.max_hamming, self._config.ratio
            )
            if len(matches.k) < _MIN_GUIDED:
                return PlaceMatch(PlaceStatus.TOO_FEW_FOUND, T_camera_map, k, j)
            estimate = self._optimize(frame, matches.k, view.points[matches.q], T_camera_map)
            T_camera_map = estimate.T_camera_map
            k, j = matches.k[estimate.inliers], view.points[matches.q[estimate.inliers]]
        view = visible_points(self._atlas, self._camera, T_camera_map, points, 1.0)
        return self._judged(frame, view, PlaceMatch(PlaceStatus.SAME_PLACE, T_camera_map, k, j))

    def _judged(self, frame: Frame, view: VisiblePoints, found: PlaceMatch) -> PlaceMatch:
        points, config = self._atlas.points, self._config
        depth_m = to_camera(found.T_camera_map, points.position_m[view.points].T)[2]
        seen = visibility(view.queries.projection_px, depth_m, frame)
        is_found = np.isin(view.points, found.j)
        expected = float(chance_found(points, view.points[seen.observable]).sum())
        contradicted = np.count_nonzero(seen.contradicted & ~is_found)
        found = found._replace(
            found_share=float(np.count_nonzero(is_found & seen.observable)) / max(expected, 1.0),
            contradicted_share=float(contradicted) / max(len(view.points), 1),
        )
        if len(found.k) < config.min_inliers or found.found_share < config.min_found_share:
            return found._replace(status=PlaceStatus.TOO_FEW_FOUND)
        if found.contradicted_share > config.max_contradicted_share:
            return found._replace(status=PlaceStatus.CONTRADICTED)
        return found

    def _feature_matches(self, frame: Frame, candidate: int) -> tuple[Matches, IntArray]:
        """Return matches of the candidate's features that see points with the frame's features."""
        keyframes = self._atlas.keyframes
        observing = np.flatnonzero(keyframes.point_of_feature[candidate] != NO_POINT)
        seen = keyframes.point_of_feature[candidate, observing].astype(np.int64)
        if min(len(observing), len(frame)) < 2:
            return Matches(*np.empty((3, 0), np.int64)), seen
        distance, nearest = cv2.batchDistance(
            keyframes.descriptors[candidate, observing],
            frame.descriptors,
            cv2.CV_32S,
            normType=cv2.NORM_HAMMING,
            K=2,
        )
        q = np.repeat(np.arange(len(observing)), 2)
        k, apart = nearest.ravel().astype(np.int64), distance.ravel().astype(np.int64)
        config = self._config
        matches = best_matches(q, k, apart, frame.octave, config.max_hamming, config.ratio)
        turned = rotation_consistent(
            keyframes.angle_deg[candidate, observing[matches.q]], frame.angle_deg[matches.k]
        )
        return Matches(matches.q[turned], matches.k[turned], matches.distance[turned]), seen

    def _optimize(
        self, frame: Frame, k: IntArray, j: IntArray, T_camera_map: FloatArray
    ) -> PoseEstimate:
        problem = PoseProblem(
            self._atlas.points.position_m[j],
            frame.measurement_px[k].astype(np.float64),
            self._atlas.octave_scale[frame.octave[k]] ** -2.0,
        )
        return optimize_pose(self._camera, problem, T_camera_map)
