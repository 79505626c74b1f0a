"""New points from two keyframes that see the same thing without a trusted depth reading of it.

ORB-SLAM's local mapping (Mur-Artal and Tardos, T-RO 2017): features that see no point are matched
along epipolar lines, and a pair becomes a point when the two rays meet in front of both cameras at
an angle that tells its depth, where the images really show it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from hoid_native import Candidates, MatchThreshold, QueryConstraints
from rgbd_slam.config.slam_config import TriangulationConfig
from rgbd_slam.matching.matching import Matches
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.optimize.pose_optimizer import CHI2_MONO, CHI2_STEREO

_FAR_M = 1e4  # as good as infinity
_EPIPOLAR_CHI2 = 3.841  # 95 % of one degree of freedom
_DEPTH_SHARE = 0.3  # how far off a depth reading may be
_SCALE_MARGIN = 1.5  # octaves by which two views of one thing may differ from their distances


class TwoViews(NamedTuple):
    """What two keyframes see of each other's features that see no point."""

    first: Frame
    second: Frame
    T_second_first: FloatArray  # (4, 4)


def triangulate_with_neighbours(
    atlas: Atlas, camera: StereoCamera, i: int, config: TriangulationConfig
) -> int:
    """Make points of what keyframe `i` and its neighbours see from two sides; return how many."""
    count = 0
    for neighbour in atlas.covisible(i, limit=config.neighbours).tolist():
        count += _triangulate_with(atlas, camera, i, neighbour, config)
    return count


def _triangulate_with(
    atlas: Atlas, camera: StereoCamera, i: int, n: int, config: TriangulationConfig
) -> int:
    T_map_camera = atlas.keyframes.T_map_camera
    T_n_i = se3.inverse(T_map_camera[n]) @ T_map_camera[i]
    if np.linalg.norm(T_n_i[:3, 3]) < config.min_baseline_m:
        return 0
    views = TwoViews(atlas.keyframes.frame(i), atlas.keyframes.frame(n), T_n_i)
    k = np.flatnonzero(_is_free(atlas, i))
    matches = _matches(views, k, _is_free(atlas, n), camera, atlas.octave_scale, config)
    first, second = k[matches.q], matches.k
    depth_m = depth_from_parallax(
        views, first, second, camera, np.radians(config.min_parallax_deg)
    )
    points_m = camera.back_project(views.first.measurement_px[first], depth_m)
    good = fits_both(views, first, second, points_m, camera, atlas.octave_scale)
    j = atlas.add_points(i, first[good], se3.transform(T_map_camera[i], points_m[good]))
    atlas.observe(n, second[good], j)
    atlas.refresh(j)
    return len(j)


def _is_free(atlas: Atlas, i: int) -> BoolArray:
    keyframes = atlas.keyframes
    n = int(keyframes.num_features[i])
    free: BoolArray = keyframes.point_of_feature[i, :n] == NO_POINT
    return free & keyframes.may_seed[i, :n]


def _matches(
    views: TwoViews,
    k: IntArray,
    free: BoolArray,
    camera: StereoCamera,
    octave_scale: FloatArray,
    config: TriangulationConfig,
) -> Matches:
    """Match features `k` of the first view with free ones of the second, along epipolar lines."""
    first, second = views.first, views.second
    octave = first.octave[k].astype(np.int8)
    above = np.minimum(octave + 1, len(octave_scale) - 1).astype(np.int8)
    pairs = hoid_native.match_along_segments(
        epipolar_segments(views, k, camera, config.min_depth_m),
        np.sqrt(_EPIPOLAR_CHI2) * octave_scale,
        QueryConstraints(octave - np.int8(1), above, first.descriptors[k]),
        Candidates(second.measurement_px, second.octave, second.descriptors, free),
        MatchThreshold(config.max_hamming, config.ratio),
    )
    return Matches(*(part.astype(np.int64) for part in pairs))


def epipolar_segments(
    views: TwoViews, k: IntArray, camera: StereoCamera, min_depth_m: float
) -> FloatArray:
    """Return (N, 4) u, v of both ends of where the second view may show features of the first.

    A depth reading bounds the segment; without one it runs from `min_depth_m` to infinity. It is
    NaN for what cannot be in front of the second camera.
    """
    depth = views.first.depth_m[k].astype(np.float64)
    near = np.where(depth > 0, (1 - _DEPTH_SHARE) * depth, min_depth_m)
    far = np.where(depth > 0, (1 + _DEPTH_SHARE) * depth, _FAR_M)
    ray = camera.back_project(views.first.measurement_px[k], np.ones(len(k)))
    R, t = views.T_second_first[:3, :3], views.T_second_first[:3, 3]
    turned = ray @ R.T
    with np.errstate(divide='ignore', invalid='ignore'):
        near = np.maximum(near, (min_depth_m - t[2]) / turned[:, 2])
    ends = [camera.project(turned * d[:, None] + t)[:, :2] for d in (near, far)]
    segments = np.concatenate(ends, 1)
    segments[(turned[:, 2] <= 0) | (near >= far)] = np.nan
    return segments


def depth_from_parallax(
    views: TwoViews,
    first: IntArray,
    second: IntArray,
    camera: StereoCamera,
    min_parallax_rad: float,
) -> FloatArray:
    """Return (N,) depths in the first camera at which it sees what the second sees.

    The ray of the first camera is taken as exact; the depth makes it meet the other's in the sense
    of least squares. Rays that are nearly parallel tell no depth: then it is what either camera
    read, and 0 where neither did.
    """
    R, t = views.T_second_first[:3, :3], views.T_second_first[:3, 3]
    ones = np.ones(len(first))
    a = camera.back_project(views.first.measurement_px[first], ones) @ R.T
    b = camera.back_project(views.second.measurement_px[second], ones)
    across = np.cross(a, b)
    square = np.maximum((across * across).sum(1), 1e-18)
    depth: FloatArray = -(across * np.cross(t, b)).sum(1) / square
    sine = np.sqrt(square / ((a * a).sum(1) * (b * b).sum(1)))
    read_second = (views.second.depth_m[second] - t[2]) / a[:, 2]
    read = np.where(views.second.depth_m[second] > 0, read_second, 0.0)
    read = np.where(views.first.depth_m[first] > 0, views.first.depth_m[first], read)
    return np.where(sine > np.sin(min_parallax_rad), depth, read)


def fits_both(
    views: TwoViews,
    first: IntArray,
    second: IntArray,
    points_m: FloatArray,
    camera: StereoCamera,
    octave_scale: FloatArray,
) -> BoolArray:
    """Return which of (N, 3) points in the first camera's frame are where both views show them."""
    in_second = se3.transform(views.T_second_first, points_m)
    good = (points_m[:, 2] > 0) & (in_second[:, 2] > 0)
    points_m, in_second = (np.where(good[:, None], x, 1.0) for x in (points_m, in_second))
    for frame, k, x in ((views.first, first, points_m), (views.second, second, in_second)):
        error2 = (camera.project(x) - frame.measurement_px[k]) ** 2
        has_depth = frame.depth_m[k] > 0
        chi2 = error2[:, 0] + error2[:, 1] + np.where(has_depth, error2[:, 2], 0.0)
        gate = np.where(has_depth, CHI2_STEREO, CHI2_MONO)
        good &= chi2 < gate * octave_scale[frame.octave[k]] ** 2
    distance = np.linalg.norm(in_second, axis=1) / np.linalg.norm(points_m, axis=1)
    scale = octave_scale[views.first.octave[first]] / octave_scale[views.second.octave[second]]
    margin = _SCALE_MARGIN * octave_scale[min(1, len(octave_scale) - 1)]
    good &= (distance < scale * margin) & (distance > scale / margin)
    return np.asarray(good)
