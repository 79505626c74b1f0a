"""The landmarks of a frame: map points, or depth measurements of the last frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from rgbd_slam.matching.matching import Matches, Queries, match_by_projection, rotation_consistent
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame


class Landmarks(NamedTuple):
    """N landmarks to match a frame with: map points, or depth measurements of the last frame."""

    point: IntArray  # (N,) row of the map point; NO_POINT for a depth measurement
    position_m: FloatArray  # (N, 3) in the map frame
    octave: ByteArray  # (N,) octave of the feature from which the landmark was taken
    angle_deg: Float32Array  # (N,) angle of the same feature
    descriptors: ByteArray  # (N, 32) descriptor of the map point, or of the feature with depth

    def select(self, keep: BoolArray) -> Landmarks:
        return Landmarks._make(column[keep] for column in self)

    def joined(self, other: Landmarks) -> Landmarks:
        return Landmarks(
            np.concatenate([self.point, other.point]),
            np.concatenate([self.position_m, other.position_m]),
            np.concatenate([self.octave, other.octave]),
            np.concatenate([self.angle_deg, other.angle_deg]),
            np.concatenate([self.descriptors, other.descriptors]),
        )

    def matched(self, matches: Matches) -> Correspondences:
        return Correspondences(matches.k, self.point[matches.q], self.position_m[matches.q])


class Correspondences(NamedTuple):
    """M features of a frame, each with the landmark that it observes; no feature occurs twice."""

    k: IntArray  # (M,) indices of features
    point: IntArray  # (M,) rows of map points, or NO_POINT
    position_m: FloatArray  # (M, 3) in the map frame

    def select(self, keep: BoolArray) -> Correspondences:
        n = np.flatnonzero(keep)
        return Correspondences(self.k[n], self.point[n], self.position_m.take(n, 0))

    def joined(self, other: Correspondences) -> Correspondences:
        return Correspondences(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    @property
    def points(self) -> IntArray:
        """Return the rows of the observed map points; depth measurements are left out."""
        return np.asarray(self.point[self.point != NO_POINT])


def landmarks_of_frame(last: TrackedFrame, atlas: Atlas) -> Landmarks:
    """Return those map points that a tracked frame observed and that still exist."""
    points = last.current_points(atlas)
    k = np.flatnonzero(points != NO_POINT)
    j, table = points[k], atlas.points
    return Landmarks(
        j,
        table.position_m.take(j, 0),
        last.frame.octave[k],
        last.frame.angle_deg[k],
        table.descriptors.take(j, 0),
    )


def landmarks_of_keyframe(atlas: Atlas, i: int) -> Landmarks:
    keyframes, table = atlas.keyframes, atlas.points
    k = np.flatnonzero(keyframes.point_of_feature[i] != NO_POINT)
    j = keyframes.point_of_feature[i, k].astype(np.int64)
    return Landmarks(
        j,
        table.position_m[j],
        keyframes.octave[i, k],
        keyframes.angle_deg[i, k],
        table.descriptors[j],
    )


def temporal_landmarks(last: TrackedFrame, atlas: Atlas, camera: StereoCamera) -> Landmarks:
    """Return the depth measurements of a tracked frame at features that may create a point.

    ORB-SLAM3 calls them temporal points (Tracking.cc, UpdateLastFrame). They help to track the
    next frame where the map has few points, and are then discarded.
    """
    frame = last.frame
    observes_none = last.current_points(atlas) == NO_POINT
    k = np.flatnonzero(observes_none & frame.has_depth & frame.may_seed)
    camera_m = camera.back_project(frame.measurement_px[k], frame.depth_m[k])
    return Landmarks(
        np.full(len(k), NO_POINT, np.int64),
        se3.transform(last.current_pose(atlas), camera_m),
        frame.octave[k],
        frame.angle_deg[k],
        frame.descriptors[k],
    )


def match_near_projections(
    landmarks: Landmarks,
    frame: Frame,
    projection_px: FloatArray,
    radius_px: FloatArray,
    max_hamming: int,
) -> Matches:
    """Match N landmarks one to one with features in windows around their projections (3, N).

    `radius_px` (N,) are half sides of the windows. The octave of a feature may differ by one from
    that of the landmark. Matches are left out if the angle between both features is unusual.
    """
    octave = landmarks.octave.astype(np.int8)
    queries = Queries(
        projection_px, radius_px, octave - np.int8(1), octave + np.int8(1), landmarks.descriptors
    )
    matches = match_by_projection(queries, frame, max_hamming, 1.0)
    return with_consistent_rotation(landmarks, frame, matches)


def with_consistent_rotation(landmarks: Landmarks, frame: Frame, matches: Matches) -> Matches:
    consistent = rotation_consistent(landmarks.angle_deg[matches.q], frame.angle_deg[matches.k])
    return matches.select(consistent)
