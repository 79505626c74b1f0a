"""The part of the map that a frame can see, and where it sees it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray
from rgbd_slam.matching.matching import Queries
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.projection import MIN_DEPTH_M, to_camera

_RANGE_MARGIN = 1.2  # one octave on either side of the scale range
_MIN_VIEW_COSINE = 0.5
_FRONTAL_COSINE = 0.998
_FRONTAL_RADIUS_PX = 2.5  # ORB-SLAM's windows, seen head on and from the side
_OBLIQUE_RADIUS_PX = 4.0


class LocalMap(NamedTuple):
    """Keyframes that see what the frame sees, and their points."""

    reference: int  # the keyframe that shares most points with the frame
    keyframes: IntArray
    points: IntArray


def local_map(atlas: Atlas, seen: IntArray, last_reference: int, limit: int) -> LocalMap:
    """Return the neighbourhood of a frame that sees the given points.

    Keyframes vote by how many of the points they see. Candidates are the last reference keyframe
    and its covisible ones, so that the cost does not depend on the size of the map.
    """
    keyframes = atlas.keyframes
    candidates = np.concatenate(
        [[last_reference], atlas.covisible(last_reference, limit=2 * limit)]
    )
    flags = np.zeros(atlas.points.capacity + 1, np.bool_)
    flags[seen] = True
    flags[NO_POINT] = False
    votes = np.count_nonzero(flags.take(keyframes.point_of_feature[candidates]), axis=1)
    order = np.argsort(-votes, kind='stable')[:limit]
    reference = int(candidates[order[0]])
    chosen = candidates[order[votes[order] > 0]] if votes[order[0]] else candidates[:1]
    flags[:] = False
    flags[keyframes.point_of_feature[chosen].ravel()] = True
    flags[NO_POINT] = False
    return LocalMap(reference, chosen, np.flatnonzero(flags))


class VisiblePoints(NamedTuple):
    """Map points in the view of a camera."""

    points: IntArray  # (V,)
    queries: Queries  # over V


def predict_octave(atlas: Atlas, points: IntArray, distance_m: FloatArray) -> IntArray:
    """Return (N,) octaves in which points at a distance should be found (PredictScale)."""
    scale = atlas.octave_scale
    ratio = atlas.points.max_distance_m[points] / distance_m
    octave = np.ceil(np.log(ratio) / np.log(scale[1])) if len(scale) > 1 else 0 * ratio
    return np.clip(octave, 0, len(scale) - 1).astype(np.int64)


def visible_points(
    atlas: Atlas,
    camera: StereoCamera,
    T_camera_map: FloatArray,
    points: IntArray,
    radius: float,
) -> VisiblePoints:
    """Return which of the points the camera should see, and the windows to search for them.

    Rows are taken by their numbers: masks and lists in brackets are several times slower.

    Args:
        radius: factor on ORB-SLAM's window sizes.
    """
    table = atlas.points
    x = to_camera(T_camera_map, table.position_m.take(points, 0).T)
    front = np.flatnonzero(x[2] > MIN_DEPTH_M)
    pixels = camera.project_rows(x.take(front, 1))
    inside = np.flatnonzero(_inside(camera, pixels))
    points, pixels = points[front[inside]], pixels.take(inside, 1)
    ray = table.position_m.take(points, 0) + T_camera_map[:3, :3].T @ T_camera_map[:3, 3]
    distance = np.sqrt(_dot(ray, ray))
    cosine = _dot(ray, table.view_direction.take(points, 0)) / distance
    fits = (cosine > _MIN_VIEW_COSINE) & (distance < _RANGE_MARGIN * table.max_distance_m[points])
    fits &= distance > table.min_distance_m[points] / _RANGE_MARGIN
    seen = np.flatnonzero(fits)
    points = points[seen]
    octave = predict_octave(atlas, points, distance[seen])
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
    """Return (N,) products of the rows of two (N, 3) arrays; their sums over an axis are slow."""
    return np.asarray(np.einsum('ni,ni->n', a, b))


def _inside(camera: StereoCamera, pixels: FloatArray) -> BoolArray:
    u, v = pixels[0], pixels[1]
    u_min, v_min, u_max, v_max = camera.bounds_px
    return np.asarray((u >= u_min) & (u < u_max) & (v >= v_min) & (v < v_max))
