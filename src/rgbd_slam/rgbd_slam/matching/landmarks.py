"""What a frame may be matched with: map points seen before, and points for tracking only."""

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
    """Parallel arrays over N places in the map's frame, and how they were seen last."""

    point: IntArray  # (N,) in the map, or NO_POINT: for tracking only
    position_m: FloatArray  # (N, 3)
    octave: ByteArray  # (N,)
    angle_deg: Float32Array  # (N,)
    descriptors: ByteArray  # (N, 32)

    def select(self, keep: BoolArray) -> Landmarks:
        """Return those of an (N,) mask."""
        return Landmarks(
            self.point[keep],
            self.position_m[keep],
            self.octave[keep],
            self.angle_deg[keep],
            self.descriptors[keep],
        )

    def joined(self, other: Landmarks) -> Landmarks:
        """Return these and others."""
        return Landmarks(
            np.concatenate([self.point, other.point]),
            np.concatenate([self.position_m, other.position_m]),
            np.concatenate([self.octave, other.octave]),
            np.concatenate([self.angle_deg, other.angle_deg]),
            np.concatenate([self.descriptors, other.descriptors]),
        )


class Sightings(NamedTuple):
    """Which features of a frame show which landmarks: parallel arrays (M,), no feature twice."""

    k: IntArray
    point: IntArray  # or NO_POINT
    position_m: FloatArray  # (M, 3)

    def select(self, keep: BoolArray) -> Sightings:
        """Return those of an (M,) mask."""
        n = np.flatnonzero(keep)
        return Sightings(self.k[n], self.point[n], self.position_m.take(n, 0))

    def joined(self, other: Sightings) -> Sightings:
        """Return these and others."""
        return Sightings(
            np.concatenate([self.k, other.k]),
            np.concatenate([self.point, other.point]),
            np.concatenate([self.position_m, other.position_m]),
        )

    @property
    def points(self) -> IntArray:
        """Return those that are in the map."""
        return np.asarray(self.point[self.point != NO_POINT])


def seen_by_frame(last: TrackedFrame, atlas: Atlas) -> Landmarks:
    """Return the map points that a tracked frame saw."""
    points = last.current_points(atlas)
    k = np.flatnonzero(points != NO_POINT)
    frame, table = last.frame, atlas.points
    j = points[k]
    return Landmarks(
        j, table.position_m.take(j, 0), frame.octave[k], frame.angle_deg[k],
        table.descriptors.take(j, 0),
    )  # fmt: skip


def seen_by_keyframe(atlas: Atlas, i: int) -> Landmarks:
    """Return the map points that a keyframe sees."""
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


def read_by_frame(last: TrackedFrame, atlas: Atlas, camera: StereoCamera) -> Landmarks:
    """Return places where a tracked frame read a depth and saw no map point.

    ORB-SLAM2's temporal points (Mur-Artal and Tardos, T-RO 2017): good for tracking the next frame
    where the map has little, and forgotten after it.
    """
    frame = last.frame
    unknown = last.current_points(atlas) == NO_POINT
    k = np.flatnonzero(unknown & frame.has_depth & frame.may_seed)
    camera_m = camera.back_project(frame.measurement_px[k], frame.depth_m[k])
    return Landmarks(
        np.full(len(k), NO_POINT, np.int64),
        se3.transform(last.current_pose(atlas), camera_m),
        frame.octave[k],
        frame.angle_deg[k],
        frame.descriptors[k],
    )


def match_near(
    landmarks: Landmarks,
    frame: Frame,
    projection_px: FloatArray,
    radius_px: FloatArray,
    max_hamming: int,
) -> Matches:
    """Return the features of a frame that show landmarks near their (3, N) projections."""
    octave = landmarks.octave.astype(np.int8)
    queries = Queries(
        projection_px,
        radius_px,
        octave - np.int8(1),
        octave + np.int8(1),
        landmarks.descriptors,
    )
    return turning_alike(landmarks, frame, match_by_projection(queries, frame, max_hamming, 1.0))


def turning_alike(landmarks: Landmarks, frame: Frame, matches: Matches) -> Matches:
    """Return the matches that turn in the image as many others do."""
    consistent = rotation_consistent(landmarks.angle_deg[matches.q], frame.angle_deg[matches.k])
    return Matches(*(part[consistent] for part in matches))
