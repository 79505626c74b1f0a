"""The local map of a frame: the map points that it may show, with predicted projections."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray
from rgbd_slam.matching.matching import Queries
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera, to_camera

# Margin of the range of distances in which some octave detects a point, as a factor: one octave.
# ORB-SLAM3 has 0.8 and 1.2 (MapPoint.cc, GetMinDistanceInvariance and GetMaxDistanceInvariance).
_RANGE_MARGIN = 1.2
# At most 60 degrees from the mean viewing direction (ORB-SLAM3, Tracking.cc, SearchLocalPoints).
_MIN_VIEW_COSINE = 0.5
# Half sides of the search windows (px in octave 0) of points that are seen from their mean viewing
# direction, within 3.6 degrees, and of others (ORB-SLAM3, ORBmatcher.cc, RadiusByViewingCos).
_FRONTAL_COSINE = 0.998
_FRONTAL_RADIUS_PX = 2.5
_OBLIQUE_RADIUS_PX = 4.0


class LocalMap(NamedTuple):
    """The reference keyframe of a frame, and the map points that the frame may show."""

    reference_uid: int  # the keyframe that shares most points with the frame; else the last one
    points: IntArray  # (P,) rows


def find_local_map(atlas: Atlas, seen: IntArray, last_reference_uid: int, limit: int) -> LocalMap:
    """Return the points of the up to `limit` keyframes that share most points with a frame.

    Candidates are the last reference keyframe, or its nearest ancestor in the map, and the
    keyframes covisible with it, so that time does not depend on the map's size. Without an
    ancestor in the map, the local map is empty. If no candidate observes any of the points `seen`,
    all keyframes are candidates. If none of these does, only the reference keyframe's points are
    used.
    """
    anchor = atlas.anchor(last_reference_uid)
    if anchor is None or anchor.row is None:
        return LocalMap(last_reference_uid, np.empty(0, np.int64))
    around = atlas.covisible(anchor.row, limit=2 * limit)
    candidates = np.concatenate([[anchor.row], around])
    votes = atlas.graph.count_observed(seen, candidates)
    if not votes.any():
        candidates, votes = np.unique(atlas.observations_of(seen).i, return_counts=True)
        if len(candidates) == 0:
            return LocalMap(last_reference_uid, atlas.points_of(np.array([anchor.row])))
    order = np.argsort(-votes, kind='stable')[:limit]
    best = candidates[order[0]]
    return LocalMap(
        int(atlas.keyframes.uid[best]), atlas.points_of(candidates[order[votes[order] > 0]])
    )


class VisiblePoints(NamedTuple):
    """V map points that a camera should see, and the queries with which to search for them."""

    points: IntArray  # (V,) rows
    queries: Queries


def _predict_octave(atlas: Atlas, points: IntArray, distance_m: FloatArray) -> IntArray:
    """Return the octave (N,) in which each point should be detected at a distance (N,).

    ORB-SLAM3, MapPoint.cc, PredictScale.
    """
    scale = atlas.octave_scale
    ratio = atlas.points.max_distance_m[points] / distance_m
    octave = np.ceil(np.log(ratio) / np.log(scale[1])) if len(scale) > 1 else 0 * ratio
    return np.clip(octave, 0, len(scale) - 1).astype(np.int64)


def visible_points(
    atlas: Atlas, camera: StereoCamera, T_camera_map: FloatArray, points: IntArray, radius: float
) -> VisiblePoints:
    """Return the points that a camera should see, and the queries with which to search for them.

    A point is visible if it projects into the image, at a distance at which some octave can detect
    it, and is seen from a direction similar to those of its keyframes (ORB-SLAM3, Frame.cc,
    isInFrustum). `radius` is a factor on the search windows of ORB-SLAM3. The code selects rows by
    `take`, which is several times as fast as masks.
    """
    table = atlas.points
    x = to_camera(T_camera_map, table.position_m.take(points, 0).T)
    front = np.flatnonzero(x[2] > MIN_DEPTH_M)
    pixels = camera.project_rows(x.take(front, 1))
    inside = np.flatnonzero(_is_inside(camera, pixels))
    points, pixels = points[front[inside]], pixels.take(inside, 1)
    ray = table.position_m.take(points, 0) + T_camera_map[:3, :3].T @ T_camera_map[:3, 3]
    distance = np.sqrt(_dot(ray, ray))
    cosine = _dot(ray, table.view_direction.take(points, 0)) / distance
    fits = (cosine > _MIN_VIEW_COSINE) & (distance < _RANGE_MARGIN * table.max_distance_m[points])
    fits &= distance > table.min_distance_m[points] / _RANGE_MARGIN
    seen = np.flatnonzero(fits)
    points = points[seen]
    octave = _predict_octave(atlas, points, distance[seen])
    window = np.where(cosine[seen] > _FRONTAL_COSINE, _FRONTAL_RADIUS_PX, _OBLIQUE_RADIUS_PX)
    queries = Queries(
        pixels.take(seen, 1),
        radius * window * atlas.octave_scale[octave],
        (octave - 1).astype(np.int8),
        octave.astype(np.int8),
        table.descriptors.take(points, 0),
    )
    return VisiblePoints(points, queries)


def _dot(a: FloatArray, b: FloatArray | Float32Array) -> FloatArray:
    """Return the dot products (N,) of the rows of two arrays (N, 3), faster than by a sum."""
    return np.asarray(np.einsum('ni,ni->n', a, b))


def _is_inside(camera: StereoCamera, pixels: FloatArray) -> BoolArray:
    u, v = pixels[0], pixels[1]
    u_min, v_min, u_max, v_max = camera.bounds_px
    return np.asarray((u >= u_min) & (u < u_max) & (v >= v_min) & (v < v_max))
