"""Triangulation of new points from two keyframes (decision 009; Mur-Artal and Tardos, T-RO 2017).

Features without a point are matched along epipolar lines. The new point is where both rays meet
or, if the angle between them is too small, at the measured depth.
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

_FAR_M = 1e4  # chosen: depth that represents infinity
_EPIPOLAR_CHI2 = 3.841  # 95 % quantile of chi-square, one degree of freedom
_DEPTH_SHARE = 0.3  # not tuned: largest relative error of a depth measurement
# Largest factor between the ratio of the distances and that of the octave scales: 1.5 times the
# scale factor (ORB-SLAM3, LocalMapping.cc, CreateNewMapPoints, ratioFactor).
_SCALE_MARGIN = 1.5
_MIN_SQUARE = 1e-18  # chosen: lower limit that keeps the division defined for parallel rays


class TwoViews(NamedTuple):
    """Two keyframes and their relative pose."""

    first: Frame
    second: Frame
    T_second_first: FloatArray  # (4, 4)


def triangulate_with_neighbors(
    atlas: Atlas, camera: StereoCamera, i: int, config: TriangulationConfig
) -> int:
    count = 0
    for neighbor in atlas.covisible(i, limit=config.neighbors).tolist():
        count += _triangulate_with(atlas, camera, i, neighbor, config)
    return count


def _triangulate_with(
    atlas: Atlas, camera: StereoCamera, i: int, n: int, config: TriangulationConfig
) -> int:
    """Triangulate points between keyframes `i` and `n` unless too near; return how many."""
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
    """Return the mask (N,) of features that observe no point and may create one."""
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
    """Return matches of features `k` along their epipolar lines with the features `free`."""
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
    """Return the ends (N, 4) u, v, u, v in px of the epipolar segments in the second view.

    With a measured depth, it covers 30 % around that; otherwise it covers depths from
    `min_depth_m` in both cameras to infinity. It is NaN if it is empty, or if the ray leads away
    from the second camera.
    """
    depth = views.first.depth_m[k].astype(np.float64)
    near = np.where(depth > 0, (1 - _DEPTH_SHARE) * depth, min_depth_m)
    far = np.where(depth > 0, (1 + _DEPTH_SHARE) * depth, _FAR_M)
    ray = camera.back_project(views.first.measurement_px[k], np.ones(len(k)))
    R, t = views.T_second_first[:3, :3], views.T_second_first[:3, 3]
    direction = ray @ R.T
    with np.errstate(divide='ignore', invalid='ignore'):
        near = np.maximum(near, (min_depth_m - t[2]) / direction[:, 2])
    ends = [camera.project(direction * d[:, None] + t)[:, :2] for d in (near, far)]
    segments = np.concatenate(ends, 1)
    segments[(direction[:, 2] <= 0) | (near >= far)] = np.nan
    return segments


def depth_from_parallax(
    views: TwoViews,
    first: IntArray,
    second: IntArray,
    camera: StereoCamera,
    min_parallax_rad: float,
) -> FloatArray:
    """Return the depths (N,) in m of matched features in the first camera; negative behind it.

    The depth is that of the point on the first ray nearest to the second ray (least squares). For
    rays with an angle below `min_parallax_rad`, it is the measured depth of the first camera, or
    follows from that of the second one; without either, it is 0.
    """
    R, t = views.T_second_first[:3, :3], views.T_second_first[:3, 3]
    ones = np.ones(len(first))
    a = camera.back_project(views.first.measurement_px[first], ones) @ R.T
    b = camera.back_project(views.second.measurement_px[second], ones)
    across = np.cross(a, b)
    square = np.maximum((across * across).sum(1), _MIN_SQUARE)
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
    """Return the mask (N,) of triangulated points that fit the features of both keyframes.

    They are in front of both cameras and project to both features, and their distances have about
    the ratio of the octave scales. `points_m` (N, 3) are in the first camera's frame.
    """
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
